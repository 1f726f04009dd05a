// What following a map costs the bus, beside sending grids and the maps of peers.
#include <fmt/format.h>
#include <mrpt/io/CMemoryStream.h>
#include <mrpt/maps/COccupancyGridMap2D.h>
#include <mrpt/obs/CObservation2DRangeScan.h>
#include <mrpt/serialization/CArchive.h>
#include <octomap/OcTree.h>
#include <zstd.h>

#include <CLI/CLI.hpp>
#include <chrono>
#include <cstdio>
#include <fstream>
#include <sstream>

#include "lib/config/config.h"
#include "lib/replication/pyramid_publisher.h"
#include "tests/bench/bandwidth/grid_messages.h"
#include "tests/bench/speed/workload.h"
#include "tests/support/map_writer.h"
#include "tests/support/scan_mapper.h"

namespace splinemap::bench {
namespace {

using std::chrono::milliseconds;

constexpr double kScansPerS = 10;
constexpr milliseconds kScanInterval(100);
constexpr milliseconds kTick(10);  // of the daemon
constexpr int kScansPerWholeMap = 10;
constexpr double kRangeMax_m = 30;

struct Competitor {
  std::string name;
  double bytes = 0;
};

double ZstdBytes(const std::string& bytes) {
  std::string compressed(ZSTD_compressBound(bytes.size()), '\0');
  return static_cast<double>(ZSTD_compress(compressed.data(), compressed.size(), bytes.data(),
                                           bytes.size(), /*compressionLevel=*/3));
}

// What a daemon publishes while nothing is lost.
class Publishing {
 public:
  Publishing(const LayerSnapshot& layer, const MapOptions& options, PublisherOptions publisher)
      : publisher_(layer, options, publisher), budget_(publisher.bytes_per_s) {}

  double BytesOf(SentScan scan, const LayerSnapshot& layer) {
    double bytes = 0;
    publisher_.AddScan(std::move(scan), now_);
    publisher_.SetLayer(layer, now_);
    for (auto passed = milliseconds(0); passed < kScanInterval; passed += kTick, now_ += kTick) {
      budget_.Refill(now_, publisher_.HasChanges(), publisher_.HasPulls());
      for (const ReplicationMessage& message : publisher_.Tick(now_, budget_)) {
        // With LCM's header.
        bytes += static_cast<double>(8 + ChannelOf(message, "SPLINEMAP").size() + 1 +
                                     EncodeReplication(message).size());
      }
    }
    return bytes;
  }

 private:
  PyramidPublisher publisher_;
  ByteBudget budget_;
  Clock::time_point now_;
};

class Octomap {
 public:
  explicit Octomap(double resolution_m) : tree_(resolution_m) {}

  void Insert(const RecordedScan& recorded) {
    octomap::Pointcloud hits_m;
    for (const PlacedBeam& beam : Place(recorded)) {
      hits_m.push_back(PointOf(beam.origin_world_m + beam.range_m * beam.direction_world));
    }
    tree_.insertPointCloud(hits_m, PointOf(recorded.world_T_sensor.position_m), kRangeMax_m,
                           /*lazy_eval=*/true, /*discretize=*/true);
  }
  std::string Serialised() {
    tree_.updateInnerOccupancy();
    std::ostringstream stream;
    tree_.writeBinaryData(stream);
    return std::move(stream).str();
  }

 private:
  static octomap::point3d PointOf(const Eigen::Vector2d& point_m) {
    return {static_cast<float>(point_m.x()), static_cast<float>(point_m.y()), 0};
  }
  octomap::OcTree tree_;
};

class Mrpt {
 public:
  Mrpt(const Workload& workload, double resolution_m) : workload_(workload) {
    const Eigen::AlignedBox2f box_m = BoundsOf(workload).cast<float>();
    map_.setSize(box_m.min().x(), box_m.max().x(), box_m.min().y(), box_m.max().y(),
                 static_cast<float>(resolution_m));
    map_.insertionOptions.maxDistanceInsertion = static_cast<float>(kRangeMax_m);
    map_.insertionOptions.considerInvalidRangesAsFreeSpace = false;
    map_.insertionOptions.wideningBeamsWithDistance = false;
  }

  void Insert(const RecordedScan& recorded) {
    mrpt::obs::CObservation2DRangeScan scan;
    scan.resizeScanAndAssign(workload_.num_beams, 0, false);
    for (const Beam& beam : recorded.scan.beams) {
      const auto k = std::lround((beam.bearing_rad - workload_.first_bearing_rad) /
                                 workload_.bearing_step_rad);
      scan.setScanRange(k, beam.range_m);
      scan.setScanRangeValidity(k, true);
    }
    const double aperture_rad = (workload_.num_beams - 1) * workload_.bearing_step_rad;
    scan.aperture = static_cast<float>(aperture_rad);
    scan.maxRange = static_cast<float>(kRangeMax_m);
    // Its scans are symmetric to the sensor's x axis.
    const Pose2& pose = recorded.world_T_sensor;
    const mrpt::poses::CPose3D world_T_scan(
        pose.position_m.x(), pose.position_m.y(), 0,
        pose.yaw_rad + workload_.first_bearing_rad + aperture_rad / 2, 0, 0);
    map_.insertObservation(scan, world_T_scan);
  }
  std::string Serialised() {
    mrpt::io::CMemoryStream stream;
    mrpt::serialization::archiveFrom(stream) << map_;
    return {static_cast<const char*>(stream.getRawBufferData()), stream.getTotalBytesCount()};
  }

 private:
  const Workload& workload_;
  mrpt::maps::COccupancyGridMap2D map_;
};

std::vector<Competitor> Measure(const Workload& workload) {
  const MapOptions options = MapOptionsOf(config::Method());
  MapWriter map(options);
  Layer& layer = map.AddLayer({"bench", 1}, {1, 1});
  ScanMapper mapper(std::make_shared<ScanFolder>(options));
  const LayerSnapshot begin = mapper.SnapshotOf(layer);
  PublisherOptions tiles_alone;
  tiles_alone.sends_scans = false;
  Publishing scans(begin, options, {});
  Publishing tiles(begin, options, tiles_alone);
  GridMessages grid(BoundsOf(workload), options);
  Octomap octomap(options.knot_interval_m);
  Mrpt mrpt(workload, options.knot_interval_m);

  Competitor of_scans{"splinemap, scans"}, of_tiles{"splinemap, tiles"};
  Competitor changed{"changed rectangle of the grid, each scan"};
  Competitor changed_zstd{changed.name + ", zstd"};
  Competitor whole{"whole grid, each second"}, whole_zstd{whole.name + ", zstd"};
  Competitor of_octomap{"OctoMap, binary, each second"}, octomap_zstd{of_octomap.name + ", zstd"};
  Competitor of_mrpt{"MRPT's grid, serialised, each second"}, mrpt_zstd{of_mrpt.name + ", zstd"};
  int count = 0;
  for (const RecordedScan& scan : workload.scans) {
    const PosedScan posed = PosedScanOf(scan);
    const SentScan sent = ScanMapper::SentOf(posed, layer);
    mapper.Map(posed, layer);
    of_scans.bytes += scans.BytesOf(sent, mapper.SnapshotOf(layer));
    of_tiles.bytes += tiles.BytesOf(sent, mapper.SnapshotOf(layer));
    grid.Update(*map.View());
    const MessageBytes rectangle = grid.DrainChanged();
    changed.bytes += rectangle.raw;
    changed_zstd.bytes += rectangle.zstd;
    octomap.Insert(scan);
    mrpt.Insert(scan);
    if (++count % kScansPerWholeMap != 0) continue;
    const MessageBytes message = grid.Whole();
    whole.bytes += message.raw;
    whole_zstd.bytes += message.zstd;
    for (const auto& [serialised, raw, zstd] :
         {std::tuple(octomap.Serialised(), &of_octomap, &octomap_zstd),
          std::tuple(mrpt.Serialised(), &of_mrpt, &mrpt_zstd)}) {
      raw->bytes += static_cast<double>(serialised.size());
      zstd->bytes += ZstdBytes(serialised);
    }
  }
  return {of_scans,   of_tiles,   changed,      changed_zstd, whole,
          whole_zstd, of_octomap, octomap_zstd, of_mrpt,      mrpt_zstd};
}

int Main(int argc, char** argv) {
  CLI::App app("bandwidth: what following a map costs the bus at 10 scans a second, in kB/s");
  bool quick = false;
  std::string json_path;
  app.add_flag("--quick", quick, "A little of everything; the figures say nothing");
  app.add_option("--json", json_path, "Also write a JSON object a line to this file");
  CLI11_PARSE(app, argc, argv);
  std::ofstream json(json_path);
  for (const char* name :
       {"intel", "freiburg_079", "csail", "aces", "belgioioso", "simulated_360_beams_3.5_m",
        "simulated_1440_beams_25_m", "simulated_1440_beams_25_m_in_mm"}) {
    const auto workload = MakeWorkload(name, quick ? 20 : 1'000'000);
    if (!workload) continue;
    const std::vector<Competitor> competitors = Measure(*workload);
    const double kb_per_s = 1e-3 * kScansPerS / static_cast<double>(workload->scans.size());
    fmt::print("\n{:<50}{:>10} {:>7}\n", name, "kB/s", "ratio");
    for (const Competitor& competitor : competitors) {
      fmt::print("{:<50}{:>10.1f} {:>7.2f}\n", competitor.name, competitor.bytes * kb_per_s,
                 competitor.bytes / competitors[0].bytes);
      json << fmt::format(
                  R"({{"workload": "{}", "competitor": "{}", "unit": "kB/s", "value": {}}})", name,
                  competitor.name, competitor.bytes * kb_per_s)
           << "\n";
    }
    std::fflush(stdout);
  }
  return json_path.empty() || json.flush() ? 0 : 1;
}

}  // namespace
}  // namespace splinemap::bench

int main(int argc, char** argv) { return splinemap::bench::Main(argc, argv); }
