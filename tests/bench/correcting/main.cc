// How long a daemon takes from a corrected trajectory to the map of it, by how many scans it keeps,
// while it maps ten scans a second, and until a follower has it; what that does to the time from a
// scan to the map, and what the follower receives.
#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <atomic>
#include <chrono>
#include <cmath>
#include <cstdlib>
#include <memory>
#include <numbers>
#include <string>
#include <thread>
#include <vector>

#include "lcmtypes/splinemap/status_t.hpp"
#include "lcmtypes/splinemap/trajectory_t.hpp"
#include "lib/base/mutex.h"
#include "lib/base/status.h"
#include "lib/logs/carmen_log.h"
#include "lib/wire/decode.h"
#include "lib/wire/encode.h"
#include "services/splinemapd/daemon.h"
#include "splinemap/replica.h"
#include "tests/support/shared_data.h"
#include "tests/support/temporary_directory.h"

namespace splinemap {
namespace {

using std::chrono::milliseconds;
using std::chrono::steady_clock;

constexpr milliseconds kPeriod{100};  // of the scans
constexpr double kDrift_m = 1;        // of the poses, when the last scan is made

double SecondsSince(steady_clock::time_point start) {
  return std::chrono::duration<double>(steady_clock::now() - start).count();
}

// A drive that goes round and round.
class Robot {
 public:
  Robot(std::vector<CarmenScan> scans, int scans_before_correction)
      : scans_(std::move(scans)), drift_m_(kDrift_m / scans_before_correction) {}

  static Utime TimeOf(int n) { return n * kPeriod; }
  const Pose2& PoseAt(int n) const { return ScanAt(n).world_T_laser; }
  // `drifts`: its localisation is not corrected yet.
  void Publish(int n, bool drifts, LcmBus& bus) const {
    const CarmenScan& scan = ScanAt(n);
    Pose2 said = scan.world_T_laser;
    if (drifts) said.position_m.x() += drift_m_ * n;
    bus.Publish("POSE", PoseMessage({TimeOf(n), said}));
    std::vector<float> ranges_m = scan.ranges_m;
    bus.Publish("LASER", PlanarLidarMessage(TimeOf(n), std::move(ranges_m), scan.first_bearing_rad,
                                            scan.bearing_step_rad));
  }

 private:
  const CarmenScan& ScanAt(int n) const { return scans_[n % scans_.size()]; }

  std::vector<CarmenScan> scans_;
  double drift_m_;  // a scan
};

// A daemon on a bus inside this process, and what it says.
class HeardDaemon {
 public:
  absl::Status Start() {
    config::Config config;
    config.set_name("robot");
    config.set_map(directory_.File("robot.splinemap"));
    config.set_pose("POSE");
    config.add_scan()->set_channel("LASER");
    SPLINEMAP_ASSIGN_OR_RETURN(auto bus, LcmBus::Open(""));
    bus_ = bus.get();
    bus_->Subscribe("SPLINEMAP_STATUS", [this](const std::string&, absl::Span<const uint8_t> m) {
      MutexLock lock(mutex_);
      status_ = *Decode<status_t>(m);
    });
    SPLINEMAP_ASSIGN_OR_RETURN(daemon_, Daemon::Start(config, std::move(bus)));
    SPLINEMAP_ASSIGN_OR_RETURN(follower_, MapReplica::Follow("", {}));
    return absl::OkStatus();
  }

  LcmBus& bus() { return *bus_; }
  status_t Status() {
    {
      MutexLock lock(publishing_);
      daemon_->PublishStatus();
    }
    std::this_thread::sleep_for(milliseconds(1));
    MutexLock lock(mutex_);
    return status_;
  }
  int64_t bytes_followed() const { return follower_->BytesReceived(); }
  uint64_t session_followed() const {
    const LayerSet set = follower_->Layers();
    return set.layers.empty() ? 0 : set.layers.front().session.number;
  }
  // Ends the program where one of them was lost.
  void AwaitMapped(int64_t scans) {
    const steady_clock::time_point start = steady_clock::now();
    while (Status().scans_mapped < scans) {
      std::this_thread::sleep_for(milliseconds(1));
      if (SecondsSince(start) < 60) continue;
      fmt::print(stderr, "scan {} was not mapped within a minute\n", scans);
      std::_Exit(1);
    }
  }
  void AwaitFollower() {
    while (!follower_->IsCaughtUp()) std::this_thread::sleep_for(milliseconds(10));
  }

 private:
  TemporaryDirectory directory_;
  Mutex mutex_;
  status_t status_ ABSL_GUARDED_BY(mutex_){};
  Mutex publishing_;
  LcmBus* bus_ = nullptr;
  std::unique_ptr<Daemon> daemon_;
  std::unique_ptr<MapReplica> follower_;
};

void PublishTrajectory(const Robot& robot, int scans, LcmBus& bus) {
  constexpr int kPosesInPart = 1500;
  const int parts = (scans + kPosesInPart - 1) / kPosesInPart;
  for (int part = 0; part < parts; ++part) {
    trajectory_t message{};
    message.utime = Robot::TimeOf(scans - 1).count();
    message.robot = "robot";
    message.part = part;
    message.num_parts = parts;
    for (int n = kPosesInPart * part; n < std::min(scans, kPosesInPart * (part + 1)); ++n) {
      const Pose2& pose = robot.PoseAt(n);
      message.pose_utime.push_back(Robot::TimeOf(n).count());
      message.x_m.push_back(pose.position_m.x());
      message.y_m.push_back(pose.position_m.y());
      message.yaw_rad.push_back(pose.yaw_rad);
    }
    message.num_poses = static_cast<int>(message.pose_utime.size());
    bus.Publish("SPLINEMAP_TRAJECTORY", message);
  }
}

// From a scan to the map that has it, in ms, of one scan after the other at their rate.
struct Latencies {
  std::vector<double> of_scans_ms;

  void Print(const char* when) {
    std::sort(of_scans_ms.begin(), of_scans_ms.end());
    const size_t size = of_scans_ms.size();
    fmt::print("  scan to map {}: median {:.1f} ms, 95 % {:.1f}, most {:.1f}, of {} scans\n", when,
               of_scans_ms[size / 2], of_scans_ms[size * 95 / 100], of_scans_ms.back(), size);
  }
};

// Publishes the scan, and returns when the next is due.
void PublishTimed(const Robot& robot, int n, bool drifts, HeardDaemon& daemon,
                  Latencies& latencies) {
  const steady_clock::time_point start = steady_clock::now();
  robot.Publish(n, drifts, daemon.bus());
  daemon.AwaitMapped(n + 1);
  latencies.of_scans_ms.push_back(1e3 * SecondsSince(start));
  std::this_thread::sleep_until(start + kPeriod);
}

absl::Status Measure(const std::vector<CarmenScan>& drive, int scans, int timed_scans) {
  const Robot robot(drive, scans);
  HeardDaemon daemon;
  SPLINEMAP_RETURN_IF_ERROR(daemon.Start());
  int n = 0;
  for (; n < scans - timed_scans; ++n) {
    robot.Publish(n, true, daemon.bus());
    if (n % 20 == 19) daemon.AwaitMapped(n - 10);  // so that the bus loses nothing
  }
  daemon.AwaitMapped(n);
  daemon.AwaitFollower();
  fmt::print("{} scans\n", scans);
  Latencies before;
  const int64_t bytes_before = daemon.bytes_followed();
  for (; n < scans; ++n) PublishTimed(robot, n, true, daemon, before);
  const double bytes_of_scan =
      static_cast<double>(daemon.bytes_followed() - bytes_before) / timed_scans;
  before.Print("before");

  const int64_t session = daemon.Status().session_number;
  const int64_t bytes_at_correction = daemon.bytes_followed();
  std::atomic<double> took_s = 0;
  std::atomic<double> followed_s = 0;
  std::thread corrector([&] {
    const steady_clock::time_point start = steady_clock::now();
    PublishTrajectory(robot, scans, daemon.bus());
    while (daemon.Status().session_number == session) {
      std::this_thread::sleep_for(milliseconds(10));
    }
    took_s = SecondsSince(start);
    while (daemon.session_followed() == static_cast<uint64_t>(session)) {
      std::this_thread::sleep_for(milliseconds(10));
    }
    followed_s = SecondsSince(start);
  });
  Latencies during;
  while (followed_s == 0) PublishTimed(robot, n++, false, daemon, during);
  corrector.join();
  during.Print("during");
  daemon.AwaitFollower();
  const status_t status = daemon.Status();
  fmt::print("  trajectory to map: {:.3f} s, {:.1f} us a scan; to that of a follower {:.3f} s\n",
             took_s.load(), 1e6 * took_s / scans, followed_s.load());
  fmt::print("  received by it: {:.2f} MB, with {} scans of {:.1f} kB each; the map has {} tiles\n",
             1e-6 * static_cast<double>(daemon.bytes_followed() - bytes_at_correction), n - scans,
             1e-3 * bytes_of_scan, status.tiles);
  return absl::OkStatus();
}

int Main(int argc, char** argv) {
  CLI::App app("Time from a corrected trajectory to its map, while a daemon maps");
  bool quick = false;
  std::vector<int> sizes = {1'000, 10'000, 100'000};
  app.add_flag("--quick", quick, "A smoke run of a few seconds; its figures mean nothing");
  app.add_option("--scans", sizes, "How many scans are kept")->check(CLI::Range(200, 1'000'000));
  CLI11_PARSE(app, argc, argv);
  const auto path = SharedData("carmen/freiburg-079-corrected.log.gz");
  if (!path) {
    fmt::print(stderr, "the recorded drive is not there (../shared/data)\n");
    return 0;
  }
  absl::StatusOr<CarmenLog> log = ReadCarmenLog(*path, std::nullopt, [](double) {});
  absl::Status status = log.status();
  if (quick) sizes = {200};
  for (size_t k = 0; k < sizes.size() && status.ok(); ++k) {
    status = Measure(log->scans, sizes[k], quick ? 5 : 100);
  }
  if (!status.ok()) fmt::print(stderr, "{}\n", ErrorText(status));
  return status.ok() ? 0 : 1;
}

}  // namespace
}  // namespace splinemap

int main(int argc, char** argv) { return splinemap::Main(argc, argv); }
