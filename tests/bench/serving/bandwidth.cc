#include "tests/bench/serving/bandwidth.h"

#include <chrono>

#include "lib/config/config.h"
#include "lib/mapping/beam_model.h"
#include "lib/mapping/scan_scratch.h"
#include "lib/replication/pyramid_publisher.h"
#include "tests/bench/serving/grid_messages.h"
#include "tests/support/map_writer.h"

namespace splinemap::bench {
namespace {

using std::chrono::milliseconds;

constexpr double kScansPerS = 10;
constexpr milliseconds kScanInterval(100);
constexpr milliseconds kTick(10);  // of the daemon
constexpr int kScansPerWholeGrid = 10;
constexpr double kHeaderBytes = 8 + sizeof("SPLINEMAP_UPDATES");  // of LCM

double BytesOf(const std::vector<ReplicationMessage>& messages) {
  double bytes = 0;
  for (const ReplicationMessage& message : messages) {
    bytes += kHeaderBytes + static_cast<double>(EncodeReplication(message).size());
  }
  return bytes;
}

}  // namespace

Figures MeasureBandwidth(const Workload& workload) {
  const config::Method method;
  const MapOptions options = MapOptionsOf(method);
  const BeamModelOptions model_options = BeamModelOptionsOf(method);
  MapWriter map(options);
  Layer& layer = map.AddLayer({"bench", 1}, {1, 1});
  BeamModel model(model_options, options.knot_interval_m);
  ScanScratch scratch;
  PyramidPublisher publisher(layer.Snapshot(), options, {});
  ByteBudget budget(PublisherOptions().bytes_per_s);
  GridMessages grid(BoundsOf(workload), options);

  double published = 0;
  MessageBytes whole;
  MessageBytes changed;
  Clock::time_point now;
  int scans = 0;
  for (const RecordedScan& scan : workload.scans) {
    model.Accumulate(Place(scan), scratch);
    scratch.CommitTo(layer, options.limits);
    publisher.SetLayer(layer.Snapshot(), now);
    for (auto passed = milliseconds(0); passed < kScanInterval; passed += kTick, now += kTick) {
      budget.Refill(now, publisher.HasChanges(), publisher.HasPulls());
      published += BytesOf(publisher.Tick(now, budget));
    }
    grid.Update(*map.View());
    const MessageBytes rectangle = grid.DrainChanged();
    changed.raw += rectangle.raw;
    changed.zstd += rectangle.zstd;
    if (++scans % kScansPerWholeGrid == 0) {
      const MessageBytes message = grid.Whole();
      whole.raw += message.raw;
      whole.zstd += message.zstd;
    }
  }
  const double kb_per_s = 1e-3 * kScansPerS / scans;
  return {workload.name,
          {"kB/s"},
          {{"splinemapd", {published * kb_per_s}},
           {"changed rectangle of the grid, 10 Hz", {changed.raw * kb_per_s}},
           {"changed rectangle of the grid, 10 Hz, zstd", {changed.zstd * kb_per_s}},
           {"whole grid, 1 Hz", {whole.raw * kb_per_s}},
           {"whole grid, 1 Hz, zstd", {whole.zstd * kb_per_s}}}};
}

}  // namespace splinemap::bench
