#include "tests/bench/serving/latency.h"

#include <algorithm>
#include <atomic>
#include <fstream>
#include <memory>
#include <optional>
#include <random>
#include <thread>

#include "lib/base/mutex.h"
#include "lib/base/status.h"
#include "lib/pipeline/mapper.h"
#include "lib/rpc/encoded.h"
#include "lib/simulation/simulation.h"
#include "lib/wire/encode.h"
#include "lib/wire/lcm_bus.h"
#include "splinemap/client.h"
#include "splinemap/local_map.h"
#include "splinemap/replica.h"
#include "tests/support/child_process.h"
#include "tests/support/map_writer.h"
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
  const ChildProcess echo({"/proc/self/exe", "--echo"});
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

    // In the view of a map whose only layer this is, which has its tiles.
    bool IsIn(const MapView& view) const {
      return std::all_of(tiles.begin(), tiles.end(),
                         [&](TileKey key) { return view.tiles.RevisionOf(key) >= revision; });
    }
  };
  Change Next(const Reading& reading) {
    const TileTree before = layer_->Snapshot().tiles;
    mapper_->HandleMessage("POSE", Encode(reading.pose));
    mapper_->HandleMessage("LASER", Encode(reading.scan));
    Change change{layer_->revision(), {}};
    layer_->Snapshot().tiles.ForEachChanged(
        before.version(), [&](TileKey key, const TileTree::Entry& entry) {
          // What a scan leaves as it was is not published.
          const StoredTile* tile = before.Find(key);
          if (tile == nullptr || !HaveEqualContent(*tile, *entry.tile)) change.tiles.push_back(key);
        });
    return change;
  }

 private:
  config::Config config_;
  MapWriter map_{MapOptionsOf({})};
  Layer* layer_;
  std::unique_ptr<Mapper> mapper_;
};

// When a change is in a replica's map. Thread-safe.
class Arrival {
 public:
  void Expect(Forecast::Change change) {
    MutexLock lock(mutex_);
    change_ = std::move(change);
    time_.reset();
  }
  void See(const MapView& view) {
    MutexLock lock(mutex_);
    if (change_ && !time_ && change_->IsIn(view)) time_ = Clock::now();
  }
  std::optional<Clock::time_point> time() const {
    MutexLock lock(mutex_);
    return time_;
  }

 private:
  mutable Mutex mutex_;
  std::optional<Forecast::Change> change_ ABSL_GUARDED_BY(mutex_);
  std::optional<Clock::time_point> time_ ABSL_GUARDED_BY(mutex_);
};

absl::StatusOr<std::vector<double>> TimeServing(const std::vector<Reading>& readings,
                                                const std::string& service, bool takes_tiles) {
  const TemporaryDirectory folder;
  std::ofstream(folder.File("config")) << "service { " << service << " }";
  SPLINEMAP_ASSIGN_OR_RETURN(const auto bus, LcmBus::Open(""));
  FollowOptions follow;
  follow.takes_tiles = takes_tiles;
  Arrival arrival;
  SPLINEMAP_ASSIGN_OR_RETURN(
      const auto replica, MapReplica::Follow("", follow, [&](const MapView& view, const Region&) {
        arrival.See(view);
      }));
  const ChildProcess daemon({SPLINEMAPD_PROGRAM, "--config", folder.File("config"), "--map",
                             folder.File("map"), "--scan", "LASER", "--pose", "POSE"});
  if (!Await([&] { return !replica->Layers().layers.empty(); })) {
    return Unavailable("no daemon");
  }
  Forecast forecast;
  std::mt19937_64 random(1);
  std::vector<double> times_ms;
  for (const Reading& reading : readings) {
    WaitForNextScan(random);
    arrival.Expect(forecast.Next(reading));
    bus->Publish("POSE", reading.pose);
    const auto begin = Clock::now();
    bus->Publish("LASER", reading.scan);
    if (!Await([&] { return arrival.time().has_value(); })) {
      return Unavailable("a scan is not in the replica's map after {} s", kDeadline.count());
    }
    times_ms.push_back(std::chrono::duration<double, std::milli>(*arrival.time() - begin).count());
  }
  // In the first seconds the daemon tries its flags on the scans, once.
  times_ms.erase(times_ms.begin(), times_ms.begin() + std::ssize(times_ms) / 8);
  return Percentiles(std::move(times_ms));
}

PointsQuery RandomPoints(size_t count) {
  std::mt19937_64 random(1);
  std::uniform_real_distribution<double> coordinate_m(0, 20);
  PointsQuery query;
  for (size_t k = 0; k < count; ++k) {
    query.points_m.emplace_back(coordinate_m(random), coordinate_m(random));
  }
  return query;
}

// Of each piece of a query as many bytes as its request and its reply have, half of them each way.
std::vector<RawMessage> MessagesLike(const PointsQuery& query) {
  const LocalMap map(std::make_shared<const MapView>());
  std::vector<RawMessage> messages;
  for (const Chunk& piece : Split(query)) {
    const auto begin = query.points_m.begin();
    const PointsQuery part{{begin + piece.begin, begin + piece.end}};
    const size_t bytes =
        EncodeRequest(query, piece, {}).size() + EncodeReply(*map.Ask(part), {}).size();
    messages.push_back({std::vector<uint8_t>(bytes / 2)});
  }
  return messages;
}

absl::StatusOr<Figures> TimeAsking(const PointsQuery& query, const MapClient& client,
                                   int repetitions) {
  constexpr size_t kWindow = 8;  // as of MapClient
  SPLINEMAP_ASSIGN_OR_RETURN(const auto bus, LcmBus::Open(""));
  size_t num_back = 0;
  bus->Subscribe(kPong, [&](const std::string&, absl::Span<const uint8_t>) { ++num_back; });
  const ChildProcess echo({"/proc/self/exe", "--echo"});
  const std::vector<RawMessage> messages = MessagesLike(query);
  const auto are_echoed = [&] {
    size_t num_sent = num_back = 0;
    while (num_back < messages.size()) {
      while (num_sent < messages.size() && num_sent < num_back + kWindow) {
        bus->Publish(kPing, messages[num_sent++]);
      }
      if (bus->Handle(milliseconds(200)) != LcmBus::Handled::kMessage) return false;
    }
    return true;
  };
  if (!Await(are_echoed)) return Unavailable("no echo");
  std::vector<double> echo_ms;
  std::vector<double> asked_ms;
  for (int n = 0; n < repetitions; ++n) {
    std::this_thread::sleep_for(milliseconds(2));
    const auto begin = Clock::now();
    if (are_echoed()) echo_ms.push_back(MillisecondsSince(begin));
    std::this_thread::sleep_for(milliseconds(2));
    const auto begin_asking = Clock::now();
    SPLINEMAP_RETURN_IF_ERROR(client.Ask(query).status());
    asked_ms.push_back(MillisecondsSince(begin_asking));
  }
  if (echo_ms.empty()) return Unavailable("no echo");
  return Figures{fmt::format("{} points", query.points_m.size()),
                 {"ms, median", "ms, 99th percentile"},
                 {{"LCM echo of the same bytes", Percentiles(std::move(echo_ms))},
                  {"MapClient asks splinemapd", Percentiles(std::move(asked_ms))}}};
}

}  // namespace

absl::StatusOr<std::vector<Figures>> MeasureAsking(int repetitions) {
  const TemporaryDirectory folder;
  SPLINEMAP_ASSIGN_OR_RETURN(const auto bus, LcmBus::Open(""));
  const ChildProcess daemon(
      {SPLINEMAPD_PROGRAM, "--map", folder.File("map"), "--scan", "LASER", "--pose", "POSE"});
  ClientOptions options;
  options.deadline = kDeadline;
  SPLINEMAP_ASSIGN_OR_RETURN(const auto client, MapClient::Connect("", options));
  const std::vector<Reading> readings = SimulateReadings(100);
  for (const Reading& reading : readings) {
    bus->Publish("POSE", reading.pose);
    bus->Publish("LASER", reading.scan);
    std::this_thread::sleep_for(milliseconds(2));
  }
  const auto is_mapped = [&] {
    const auto answer = client->Ask(PointsQuery{});
    return answer.ok() && answer->revision + 1 >= readings.size();
  };
  if (!Await(is_mapped)) return Unavailable("the scans were not mapped");
  std::vector<Figures> figures;
  for (const size_t count : {1, 10'000}) {
    SPLINEMAP_ASSIGN_OR_RETURN(figures.emplace_back(),
                               TimeAsking(RandomPoints(count), *client, repetitions));
  }
  return figures;
}

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
  SPLINEMAP_ASSIGN_OR_RETURN(auto by_scans, TimeServing(readings, "", false));
  SPLINEMAP_ASSIGN_OR_RETURN(auto fast, TimeServing(readings, "push_interval_ms: 20", true));
  SPLINEMAP_ASSIGN_OR_RETURN(auto tiles, TimeServing(readings, "", true));
  return Figures{"a scan of 360 beams",
                 {"ms, median", "ms, 99th percentile"},
                 {{"LCM echo of the scan", echo},
                  {"splinemapd to replica, scans", by_scans},
                  {"splinemapd to replica, tiles, push_interval_ms 20", fast},
                  {"splinemapd to replica, tiles", tiles}}};
}

}  // namespace splinemap::bench
