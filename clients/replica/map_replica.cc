#include "clients/replica/map_replica.h"

#include <utility>

#include "lib/base/random.h"
#include "lib/base/status.h"
#include "lib/map/map_changes.h"
#include "lib/replication/channels.h"

namespace splinemap {
namespace {

using std::chrono::milliseconds;

constexpr milliseconds kTick(10);

}  // namespace

absl::StatusOr<std::unique_ptr<MapReplica>> MapReplica::Follow(const std::string& url,
                                                               FollowOptions options,
                                                               OnChange on_change) {
  SPLINEMAP_ASSIGN_OR_RETURN(std::unique_ptr<LcmBus> bus, LcmBus::Open(url));
  return std::unique_ptr<MapReplica>(
      new MapReplica(std::move(bus), std::move(options), std::move(on_change)));
}

MapReplica::MapReplica(std::unique_ptr<LcmBus> bus, FollowOptions options, OnChange on_change)
    : bus_(std::move(bus)),
      on_change_(std::move(on_change)),
      channel_prefix_(options.channel_prefix),
      follower_(std::move(options), RandomId()),
      snapshot_(std::make_shared<const MapSnapshot>()),
      local_map_(snapshot_),
      following_([this](const std::stop_token& stop) { Run(stop); }) {}

void MapReplica::Run(const std::stop_token& stop) {
  std::vector<std::string> channels;
  {
    MutexLock lock(mutex_);
    channels = follower_.Channels();
  }
  bool is_changed = false;
  for (const std::string& channel : channels) {
    bus_->Subscribe(channel, [&](const std::string&, absl::Span<const uint8_t> message) {
      MutexLock lock(mutex_);
      follower_.HandleMessage(message, Clock::now());
      is_changed = true;
    });
  }
  Clock::time_point next_tick;
  Clock::time_point next_show;
  while (!stop.stop_requested()) {
    bus_->Handle(kTick);
    // What one commit changed comes in several messages, which are shown together.
    const Clock::time_point drain_end = Clock::now() + kTick;
    while (Clock::now() < drain_end && bus_->Handle(milliseconds(0)) == LcmBus::Handled::kMessage) {
    }
    const Clock::time_point now = Clock::now();
    std::vector<MapFollower::Message> messages;
    std::shared_ptr<const MapSnapshot> snapshot;
    if (now >= next_tick) {
      next_tick = now + kTick;
      MutexLock lock(mutex_);
      messages = follower_.Tick(now);
    }
    // The first change after a pause at once, and many in a row together.
    if (is_changed && now >= next_show) {
      next_show = now + kTick;
      is_changed = false;
      MutexLock lock(mutex_);
      snapshot = follower_.Snapshot();
    }
    for (const MapFollower::Message& message : messages) {
      std::visit([&](const auto& m) { bus_->Publish(channel_prefix_ + ChannelOf(m), m); }, message);
    }
    if (snapshot) Show(std::move(snapshot));
  }
}

void MapReplica::Show(std::shared_ptr<const MapSnapshot> snapshot) {
  std::shared_ptr<const MapSnapshot> before;
  {
    MutexLock lock(snapshot_mutex_);
    before = std::exchange(snapshot_, snapshot);
  }
  local_map_.Show(snapshot);
  if (!on_change_) return;
  const std::optional<Region> changed = ChangedRegion(*before, *snapshot);
  if (changed) on_change_(*snapshot, *changed);
}

std::shared_ptr<const MapSnapshot> MapReplica::WholeSnapshot() const {
  MutexLock lock(mutex_);
  return follower_.WholeSnapshot();
}

std::vector<FollowedLayer> MapReplica::Layers() const {
  MutexLock lock(mutex_);
  return follower_.Layers(Clock::now());
}

LayerControls MapReplica::Controls() const {
  MutexLock lock(mutex_);
  return follower_.controls();
}

std::vector<std::string> MapReplica::Refused() const {
  MutexLock lock(mutex_);
  return follower_.refused();
}

int64_t MapReplica::BytesReceived() const {
  MutexLock lock(mutex_);
  return follower_.bytes_received();
}

}  // namespace splinemap
