#include "tests/bench/serving/latency.h"

#include <fcntl.h>
#include <signal.h>
#include <spawn.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <fstream>
#include <memory>
#include <random>
#include <thread>

#include "clients/replica/map_replica.h"
#include "lib/base/status.h"
#include "lib/pipeline/mapper.h"
#include "lib/simulation/simulation.h"
#include "lib/wire/encode.h"
#include "tests/support/raw_message.h"
#include "tests/support/temporary_directory.h"

namespace splinemap::bench {
namespace {

using std::chrono::microseconds;
using std::chrono::milliseconds;
using std::chrono::seconds;

constexpr char kPing[] = "BENCH_PING";
constexpr char kPong[] = "BENCH_PONG";
constexpr seconds kDeadline(20);

// A program that runs as long as this lives, silently.
class Process {
 public:
  explicit Process(std::vector<std::string> arguments) {
    std::vector<char*> argv;
    for (std::string& argument : arguments) argv.push_back(argument.data());
    argv.push_back(nullptr);
    posix_spawn_file_actions_t actions;
    posix_spawn_file_actions_init(&actions);
    posix_spawn_file_actions_addopen(&actions, STDERR_FILENO, "/dev/null", O_WRONLY, 0);
    if (posix_spawn(&pid_, argv[0], &actions, nullptr, argv.data(), environ) != 0) pid_ = 0;
    posix_spawn_file_actions_destroy(&actions);
  }
  ~Process() {
    if (pid_ == 0) return;
    kill(pid_, SIGTERM);
    waitpid(pid_, nullptr, 0);
  }
  Process(const Process&) = delete;
  Process& operator=(const Process&) = delete;

 private:
  pid_t pid_ = 0;
};

template <typename Condition>
bool Await(Condition condition) {
  const auto deadline = Clock::now() + kDeadline;
  while (!condition()) {
    if (Clock::now() > deadline) return false;
    std::this_thread::sleep_for(microseconds(100));
  }
  return true;
}

// A scan, with the pose at its time that has to be sent first.
struct Reading {
  bot_core::pose_t pose;
  bot_core::planar_lidar_t scan;
};

std::vector<Reading> SimulateReadings(int scans) {
  const simulation::World world = OfficeFloor();
  const Drive drive = *Drive::Plan(world);
  const ScannerOptions scanner;
  std::mt19937_64 random(1);
  std::vector<Reading> readings;
  for (int n = 0; n < scans; ++n) {
    const milliseconds time(100 * n);
    const double time_s = std::chrono::duration<double>(time).count();
    const Pose2 pose = drive.PoseAt(time_s);
    const Utime utime = seconds(1000) + time;
    readings.push_back(
        {PoseMessage({utime, pose}),
         PlanarLidarMessage(utime, SimulateScan(world, time_s, pose, scanner, random),
                            scanner.FirstBearing(), scanner.BearingStep())});
  }
  return readings;
}

// Scans come at any phase of the daemon's intervals, 10 a second.
void WaitForNextScan(std::mt19937_64& random) {
  std::this_thread::sleep_for(milliseconds(std::uniform_int_distribution(50, 150)(random)));
}

std::vector<double> Percentiles(std::vector<double> times_ms) {
  std::sort(times_ms.begin(), times_ms.end());
  return {times_ms[times_ms.size() / 2], times_ms[times_ms.size() * 99 / 100]};
}

double MillisecondsSince(Clock::time_point begin) {
  return std::chrono::duration<double, std::milli>(Clock::now() - begin).count();
}

absl::StatusOr<std::vector<double>> TimeEcho(const std::vector<Reading>& readings) {
  SPLINEMAP_ASSIGN_OR_RETURN(const auto bus, LcmBus::Open(""));
  bool is_back = false;
  bus->Subscribe(kPong, [&](const std::string&, absl::Span<const uint8_t>) { is_back = true; });
  const Process echo({"/proc/self/exe", "--echo"});
  const auto is_echoed = [&](const bot_core::planar_lidar_t& scan) {
    is_back = false;
    bus->Publish(kPing, scan);
    while (!is_back && bus->Handle(milliseconds(100)) == LcmBus::Handled::kMessage) {
    }
    return is_back;
  };
  if (!Await([&] { return is_echoed(readings[0].scan); })) return Unavailable("no echo");
  std::vector<double> times_ms;
  for (const Reading& reading : readings) {
    std::this_thread::sleep_for(milliseconds(2));
    const auto begin = Clock::now();
    if (is_echoed(reading.scan)) times_ms.push_back(MillisecondsSince(begin));
  }
  return Percentiles(std::move(times_ms));
}

// What the daemon's map will be: the same messages in the same order make the same layer.
class Forecast {
 public:
  Forecast() {
    config_.set_pose("POSE");
    config_.add_scan()->set_channel("LASER");
    layer_ = &map_.AddLayer({"bench", 1}, {1, 1});
    mapper_ = std::make_unique<Mapper>(config_, map_.options(), *layer_);
  }

  struct Change {
    uint64_t revision;
    std::vector<TileKey> tiles;

    bool IsIn(const LayerSnapshot& layer) const {
      return std::all_of(tiles.begin(), tiles.end(),
                         [&](TileKey key) { return layer.tiles.RevisionOf(key) >= revision; });
    }
  };
  Change Next(const Reading& reading) {
    const TileTree before = layer_->Snapshot().tiles;
    mapper_->HandleMessage("POSE", Encode(reading.pose));
    mapper_->HandleMessage("LASER", Encode(reading.scan));
    Change change{layer_->revision(), {}};
    layer_->Snapshot().tiles.ForEachChanged(before.epoch(),
                                            [&](TileKey key, const TileTree::Entry& entry) {
                                              // What a scan leaves as it was is not published.
                                              const Tile* tile = before.Find(key);
                                              if (tile == nullptr || *tile != *entry.tile)
                                                change.tiles.push_back(key);
                                            });
    return change;
  }

 private:
  config::Config config_;
  Map map_{MapOptionsOf({})};
  Layer* layer_;
  std::unique_ptr<Mapper> mapper_;
};

absl::StatusOr<std::vector<double>> TimeServing(const std::vector<Reading>& readings,
                                                const std::string& service) {
  const TemporaryDirectory folder;
  std::ofstream(folder.File("config")) << "service { " << service << " }";
  SPLINEMAP_ASSIGN_OR_RETURN(const auto bus, LcmBus::Open(""));
  SPLINEMAP_ASSIGN_OR_RETURN(const auto replica, MapReplica::Follow("", {}));
  const Process daemon({SPLINEMAPD_PROGRAM, "--config", folder.File("config"), "--map",
                        folder.File("map"), "--scan", "LASER", "--pose", "POSE"});
  if (!Await([&] { return !replica->Snapshot()->layers.empty(); })) {
    return Unavailable("no daemon");
  }
  Forecast forecast;
  std::mt19937_64 random(1);
  std::vector<double> times_ms;
  for (const Reading& reading : readings) {
    WaitForNextScan(random);
    const Forecast::Change change = forecast.Next(reading);
    bus->Publish("POSE", reading.pose);
    const auto begin = Clock::now();
    bus->Publish("LASER", reading.scan);
    if (!Await([&] { return change.IsIn(replica->Snapshot()->layers[0]); })) {
      return Unavailable("a scan is not in the replica's map after {} s", kDeadline.count());
    }
    times_ms.push_back(MillisecondsSince(begin));
  }
  return Percentiles(std::move(times_ms));
}

}  // namespace

absl::Status Echo() {
  SPLINEMAP_ASSIGN_OR_RETURN(const auto bus, LcmBus::Open(""));
  bus->Subscribe(kPing, [&](const std::string&, absl::Span<const uint8_t> message) {
    bus->Publish(kPong, RawMessage{{message.begin(), message.end()}});
  });
  while (true) bus->Handle(milliseconds(1000));
}

absl::StatusOr<Figures> MeasureLatency(int scans) {
  const std::vector<Reading> readings = SimulateReadings(scans);
  SPLINEMAP_ASSIGN_OR_RETURN(auto echo, TimeEcho(readings));
  SPLINEMAP_ASSIGN_OR_RETURN(auto at_least, TimeServing(readings, "push_interval_ms: 20"));
  SPLINEMAP_ASSIGN_OR_RETURN(auto by_default, TimeServing(readings, ""));
  return Figures{"a scan of 360 beams",
                 {"ms, median", "ms, 99th percentile"},
                 {{"LCM echo of the scan", echo},
                  {"splinemapd to replica, push_interval_ms 20", at_least},
                  {"splinemapd to replica, defaults", by_default}}};
}

}  // namespace splinemap::bench
