#include "tests/bench/fleet/robot_fleet.h"

#include <chrono>
#include <string>

#include "fmt/format.h"
#include "lcmtypes/splinemap/layer_pull_t.hpp"
#include "lcmtypes/splinemap/scan_pull_t.hpp"
#include "lib/config/config.h"
#include "lib/replication/replication_message.h"
#include "lib/tiles/tile_codec.h"
#include "lib/wire/decode.h"

namespace splinemap::bench {
namespace {

using std::chrono::milliseconds;

constexpr milliseconds kScanInterval(100);
constexpr milliseconds kTick(10);
constexpr int kTicks = kScanInterval / kTick;
constexpr const char* kPrefix = "SPLINEMAP";
constexpr double kHeaderBytes = 8 + sizeof("SPLINEMAP_UPDATES");  // of LCM

PublisherOptions OptionsOf(bool sends_scans) {
  PublisherOptions options;
  options.sends_scans = sends_scans;
  return options;
}

}  // namespace

RobotFleet::Robot::Robot(int number, bool sends_scans, std::shared_ptr<ScanFolder> folder,
                         size_t first_scan)
    : map(folder->options()),
      layer(map.AddLayer({fmt::format("robot-{}", number), static_cast<uint64_t>(number) + 1},
                         {1, static_cast<uint64_t>(number) + 1})),
      mapper(std::move(folder)),
      publisher(mapper.SnapshotOf(layer), map.options(), OptionsOf(sends_scans)),
      next_scan(first_scan) {}

RobotFleet::RobotFleet(int robots, bool sends_scans, const Workload& workload, LcmBus& bus,
                       std::shared_ptr<const KeyRing> keys)
    : workload_(workload), bus_(bus), keys_(std::move(keys)) {
  const auto folder = std::make_shared<ScanFolder>(MapOptionsOf({}));
  for (int k = 0; k < robots; ++k) {
    const size_t first_scan = workload.scans.size() * k / robots;
    robots_.push_back(std::make_unique<Robot>(k, sends_scans, folder, first_scan));
  }
  bus_.Subscribe(ChannelOf(scan_pull_t(), kPrefix),
                 [this](const std::string&, absl::Span<const uint8_t> message) {
                   const auto pull = Decode<scan_pull_t>(message);
                   if (!pull.ok()) return;
                   MutexLock lock(mutex_);
                   for (const auto& robot : robots_)
                     robot->publisher.HandleScanPull(*pull, Clock::now());
                 });
  bus_.Subscribe(ChannelOf(layer_pull_t(), kPrefix),
                 [this](const std::string&, absl::Span<const uint8_t> message) {
                   const auto pull = Decode<layer_pull_t>(message);
                   if (!pull.ok()) return;
                   MutexLock lock(mutex_);
                   for (const auto& robot : robots_)
                     robot->publisher.HandlePull(*pull, Clock::now());
                 });
  running_ = std::jthread([this](const std::stop_token& stop) { Run(stop); });
}

void RobotFleet::Run(const std::stop_token& stop) {
  auto next = Clock::now();
  for (int64_t round = 0; !stop.stop_requested(); ++round, next += kTick) {
    std::this_thread::sleep_until(next);
    MutexLock lock(mutex_);
    const auto now = Clock::now();
    totals_.late_rounds += now - next > milliseconds(50) ? 1 : 0;
    for (size_t k = 0; k < robots_.size(); ++k) {
      Robot& robot = *robots_[k];
      const bool is_due = round % kTicks == static_cast<int64_t>(k) % kTicks;
      if (is_due && !is_resting_) MapNextScan(robot);
      robot.budget.Refill(now, robot.publisher.HasChanges(), robot.publisher.HasPulls());
      Publish(robot.publisher.Tick(now, robot.budget));
    }
  }
}

void RobotFleet::MapNextScan(Robot& robot) {
  const PosedScan scan = PosedScanOf(workload_.scans[robot.next_scan]);
  robot.publisher.AddScan(ScanMapper::SentOf(scan, robot.layer), Clock::now());
  robot.mapper.Map(scan, robot.layer);
  robot.next_scan = (robot.next_scan + 1) % workload_.scans.size();
  const LayerSnapshot snapshot = robot.mapper.SnapshotOf(robot.layer);
  snapshot.tiles.ForEach([&](TileKey, const TileTree::Entry& entry) {
    totals_.changed_tiles += entry.revision == snapshot.revision ? 1 : 0;
  });
  robot.publisher.SetLayer(snapshot, Clock::now());
}

void RobotFleet::Publish(const std::vector<ReplicationMessage>& messages) {
  for (const ReplicationMessage& message : messages) {
    const std::string channel = ChannelOf(message, kPrefix);
    const std::vector<uint8_t> bytes = Signed(keys_.get(), channel, EncodeReplication(message));
    totals_.bytes += static_cast<int64_t>(kHeaderBytes) + std::ssize(bytes);
    bus_.PublishBytes(channel, bytes);
    ++totals_.messages;
  }
}

RobotFleet::Totals RobotFleet::totals() const {
  MutexLock lock(mutex_);
  Totals totals = totals_;
  for (const auto& robot : robots_) totals.tiles += robot->layer.tiles().size();
  return totals;
}

void RobotFleet::Rest() {
  MutexLock lock(mutex_);
  is_resting_ = true;
}

std::vector<int64_t> RobotFleet::Hashes() const {
  MutexLock lock(mutex_);
  std::vector<int64_t> hashes;
  for (const auto& robot : robots_) {
    uint64_t hash = 0;
    robot->layer.tiles().ForEach([&](TileKey key, const TileTree::Entry& entry) {
      hash += TileChecksum(key, *entry.tile->Get());
    });
    hashes.push_back(static_cast<int64_t>(hash));
  }
  return hashes;
}

}  // namespace splinemap::bench
