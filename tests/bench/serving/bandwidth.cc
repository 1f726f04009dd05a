#include "tests/bench/serving/bandwidth.h"

#include <chrono>
#include <variant>

#include "lib/config/config.h"
#include "lib/mapping/beam_model.h"
#include "lib/mapping/scan_scratch.h"
#include "lib/replication/levels_publisher.h"
#include "tests/bench/serving/grid_messages.h"

namespace splinemap::bench {
namespace {

using std::chrono::milliseconds;

constexpr double kScansPerS = 10;
constexpr milliseconds kScanInterval(100);
constexpr milliseconds kTick(10);  // of the daemon
constexpr int kScansPerWholeGrid = 10;
constexpr double kHeaderBytes = 8 + sizeof("SPLINEMAP_UPDATES");  // of LCM

double BytesOf(const std::vector<PublishedMessage>& messages) {
  double bytes = 0;
  for (const PublishedMessage& message : messages) {
    bytes += kHeaderBytes + std::visit([](const auto& m) { return m.getEncodedSize(); }, message);
  }
  return bytes;
}

}  // namespace

Figures MeasureBandwidth(const Workload& workload) {
  const config::Method method;
  const MapOptions options = MapOptionsOf(method);
  const BeamModelOptions model_options = BeamModelOptionsOf(method);
  Map map(options);
  Layer& layer = map.AddLayer({"bench", 1}, {1, 1});
  BeamModel model(model_options, options.knot_interval_m);
  ScanScratch scratch;
  LevelsPublisher publisher(layer.Snapshot(), options, {});
  GridMessages grid(BoundsOf(workload), options);

  double published = 0;
  MessageBytes whole;
  MessageBytes changed;
  Clock::time_point now;
  int scans = 0;
  for (const RecordedScan& scan : workload.scans) {
    model.Accumulate(Place(scan), scratch);
    scratch.CommitTo(layer, options.limits);
    const auto snapshot = map.Snapshot();
    publisher.SetLayer(snapshot->layers[0], now);
    for (auto passed = milliseconds(0); passed < kScanInterval; passed += kTick, now += kTick) {
      published += BytesOf(publisher.Tick(now));
    }
    grid.Update(*snapshot);
    const MessageBytes rectangle = grid.TakeChanged();
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
