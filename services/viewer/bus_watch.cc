#include "services/viewer/bus_watch.h"

#include <algorithm>
#include <utility>

#include "lcmtypes/michigan/pose_xyt_t.hpp"
#include "lib/base/host_clock.h"
#include "lib/base/random.h"
#include "lib/base/status.h"
#include "lib/wire/decode.h"
#include "lib/wire/message_type.h"
#include "lib/wire/sensor_messages.h"
#include "splinemap/fixed_pose2.h"

namespace splinemap {
namespace {

using std::chrono::milliseconds;

constexpr milliseconds kLongest(1000);
constexpr size_t kMaxPathPoints = 10'000;
constexpr std::chrono::seconds kLong(10);

// Keeps the newest of a key, and of no more keys than there is room for: what was not heard for
// long goes first.
template <typename Map, typename Key, typename Value>
void Put(Map& map, const Key& key, Value value) {
  const Clock::time_point now = Clock::now();
  if (map.size() >= BusState::kMaxKeys && !map.contains(key)) {
    const auto oldest = std::min_element(map.begin(), map.end(), [](const auto& a, const auto& b) {
      return a.second.time < b.second.time;
    });
    if (now - oldest->second.time < kLong) return;
    map.erase(oldest);
  }
  map[key] = {std::move(value), now};
}

// Live is better than what only a file of another daemon says.
int RankOf(const std::string& state) {
  return state == "own" || state == "live" ? 2 : state == "stale" ? 1 : 0;
}

}  // namespace

absl::StatusOr<std::unique_ptr<BusWatch>> BusWatch::Start(const std::string& lcm_url,
                                                          const WatchOptions& options,
                                                          std::function<void()> on_news) {
  SPLINEMAP_ASSIGN_OR_RETURN(std::unique_ptr<LcmBus> bus, LcmBus::Open(lcm_url));
  std::unique_ptr<BusWatch> watch(new BusWatch(std::move(bus), options, std::move(on_news)));
  watch->watching_ = std::jthread([w = watch.get()](const std::stop_token& stop) { w->Run(stop); });
  return watch;
}

BusWatch::BusWatch(std::unique_ptr<LcmBus> bus, const WatchOptions& options,
                   std::function<void()> on_news)
    : options_(options),
      on_news_(std::move(on_news)),
      bus_(std::move(bus)),
      admission_(options.channel_prefix, options.keys, RandomId()),
      scans_(options.scans, options.poses.empty() ? "" : options.poses[0]),
      caller_(*bus_, options.channel_prefix, options.keys) {}

BusWatch::~BusWatch() = default;

void BusWatch::Run(const std::stop_token& stop) {
  const std::stop_callback wake(stop, [this] { bus_->Wake(); });
  bus_->SubscribeToAll([this](const std::string& channel, absl::Span<const uint8_t> message) {
    HandleMessage(channel, message);
  });
  while (!stop.stop_requested()) bus_->Handle(kLongest);
}

void BusWatch::HandleMessage(const std::string& channel, absl::Span<const uint8_t> message) {
  if (channel == options_.channel_prefix + "_STATUS") {
    HandleStatus(message);
  } else if (channel == options_.channel_prefix + "_LAYERS") {
    HandleLayers(message);
  } else if (!channel.starts_with(options_.channel_prefix + "_")) {
    const std::optional<MessageType> type = TypeOf(message);
    if (type && IsPose(*type)) HandlePose(channel, message);
    if (type == MessageType::kPath2d) HandlePath(channel, message);
    scans_.HandleMessage(channel, message, Utime(HostUtime()));
    std::vector<std::pair<std::string, ShownScan>> placed = scans_.Take();
    if (placed.empty()) return;
    {
      MutexLock lock(mutex_);
      for (auto& [scan_channel, scan] : placed) Put(state_.scans, scan_channel, std::move(scan));
    }
    on_news_();
  }
}

void BusWatch::HandleStatus(absl::Span<const uint8_t> message) {
  const absl::StatusOr<status_t> status = Decode<status_t>(message);
  if (!status.ok()) return;
  {
    MutexLock lock(mutex_);
    // A daemon that was started again is the same one for people.
    std::erase_if(state_.daemons, [&](const auto& other) {
      return other.first != status->daemon_nonce && other.second.value.name == status->name &&
             other.second.value.origin == status->origin;
    });
    Put(state_.daemons, status->daemon_nonce, *status);
  }
  on_news_();
}

void BusWatch::HandleLayers(absl::Span<const uint8_t> message) {
  const auto admitted = admission_.Admit(message);
  const auto* layers = admitted ? std::get_if<layers_t>(&admitted->content) : nullptr;
  if (layers == nullptr) return;
  const Clock::time_point now = Clock::now();
  MutexLock lock(mutex_);
  for (const layer_status_t& layer : layers->layers) {
    const LayerId id{layer.settings.name, static_cast<uint64_t>(layer.settings.origin)};
    const auto known = state_.layers.find(id);
    const bool is_better = known == state_.layers.end() ||
                           RankOf(layer.state) >= RankOf(known->second.value.status.state) ||
                           now - known->second.time > std::chrono::seconds(3);
    const Pose2 frame{{layer.frame_x_m, layer.frame_y_m}, layer.frame_yaw_rad};
    if (layer.state == "own" && FixedPose2::IsInRange(frame)) Put(state_.frames, id, frame);
    if (is_better) Put(state_.layers, id, BusLayer{layer, layers->name});
  }
}

void BusWatch::HandlePose(const std::string& channel, absl::Span<const uint8_t> message) {
  if (!IsShown(options_.poses, channel)) return;
  const absl::StatusOr<TimedPose> pose = DecodePose(message);
  if (!pose.ok()) return;
  {
    MutexLock lock(mutex_);
    Put(state_.poses, channel, pose->world_T_robot);
  }
  on_news_();
}

void BusWatch::HandlePath(const std::string& channel, absl::Span<const uint8_t> message) {
  if (!IsShown(options_.paths, channel)) return;
  const absl::StatusOr<std::vector<Pose2>> path = DecodePath(message);
  if (!path.ok() || path->size() > kMaxPathPoints) return;
  std::vector<Eigen::Vector2d> points_m;
  for (const Pose2& pose : *path) points_m.push_back(pose.position_m);
  {
    MutexLock lock(mutex_);
    Put(state_.paths, channel, std::move(points_m));
  }
  on_news_();
}

bool BusWatch::IsShown(const std::vector<std::string>& channels, const std::string& channel) const {
  return channels.empty() || std::find(channels.begin(), channels.end(), channel) != channels.end();
}

BusState BusWatch::State() const {
  MutexLock lock(mutex_);
  return state_;
}

void BusWatch::Call() {
  MutexLock lock(mutex_);
  caller_.Tick(Clock::now());
}

void BusWatch::PublishGoal(const std::string& channel, const Pose2& goal) {
  michigan::pose_xyt_t message;
  message.utime = HostUtime();
  message.x = static_cast<float>(goal.position_m.x());
  message.y = static_cast<float>(goal.position_m.y());
  message.theta = static_cast<float>(goal.yaw_rad);
  bus_->Publish(channel, message);
}

}  // namespace splinemap
