#include <thread>
#include <utility>

#include "lib/base/mutex.h"
#include "lib/base/random.h"
#include "lib/base/status.h"
#include "lib/map/map_changes.h"
#include "lib/replication/map_follower.h"
#include "lib/wire/lcm_bus.h"
#include "splinemap/local_map.h"
#include "splinemap/replica.h"

namespace splinemap {

using std::chrono::milliseconds;

class MapReplica::Impl {
 public:
  Impl(std::unique_ptr<LcmBus> bus, FollowOptions options, OnChange on_change)
      : bus_(std::move(bus)),
        on_change_(std::move(on_change)),
        channel_prefix_(options.channel_prefix),
        keys_(options.keys),
        follower_(std::move(options), RandomId()),
        following_([this](const std::stop_token& stop) { Run(stop); }) {}

  std::shared_ptr<const MapView> View() const { return map_.View(); }
  const LocalMap& map() const { return map_; }
  const LcmBus& bus() const { return *bus_; }

  // What `read` says of the follower.
  template <typename Read>
  auto OfFollower(Read read) {
    MutexLock lock(mutex_);
    return read(follower_);
  }

 private:
  static constexpr milliseconds kTick{10};
  // What one commit changed may come in several messages, whose first is not kept waiting.
  static constexpr milliseconds kPublishInterval{5};

  void Run(const std::stop_token& stop);
  void Publish(std::shared_ptr<const MapView> view);

  std::unique_ptr<LcmBus> bus_;
  const OnChange on_change_;
  const std::string channel_prefix_;
  const std::shared_ptr<const KeyRing> keys_;
  Mutex mutex_;
  MapFollower follower_ ABSL_GUARDED_BY(mutex_);
  ByteBudget budget_ ABSL_GUARDED_BY(mutex_){PublisherOptions().bytes_per_s};
  uint64_t version_ ABSL_GUARDED_BY(mutex_) = 0;  // of the follower, that was published last
  LocalMap map_{std::make_shared<const MapView>()};
  std::jthread following_;
};

void MapReplica::Impl::Run(const std::stop_token& stop) {
  const std::stop_callback wake(stop, [this] { bus_->Wake(); });
  bool is_told = false;     // something was received
  bool is_changed = false;  // the map, since it was published last
  for (const std::string& channel : ReplicationChannels(channel_prefix_)) {
    bus_->Subscribe(channel, [&](const std::string&, absl::Span<const uint8_t> message) {
      MutexLock lock(mutex_);
      follower_.HandleBytes(message, Clock::now());
      is_told = true;
    });
  }
  Clock::time_point next_tick;
  Clock::time_point next_publish;
  while (!stop.stop_requested()) {
    const Clock::time_point next = is_changed ? std::min(next_tick, next_publish) : next_tick;
    bus_->Handle(std::max(std::chrono::ceil<milliseconds>(next - Clock::now()), milliseconds(0)));
    const Clock::time_point drain_end = Clock::now() + kTick;
    while (Clock::now() < drain_end && bus_->Handle(milliseconds(0)) == LcmBus::Handled::kMessage) {
    }
    const Clock::time_point now = Clock::now();
    std::vector<ReplicationMessage> messages;
    std::shared_ptr<const MapView> view;
    {
      MutexLock lock(mutex_);
      if (std::exchange(is_told, false) || now >= next_tick) {
        budget_.Refill(now, /*has_changes=*/false, follower_.HasPulls());
        messages = follower_.Tick(now, budget_);
        next_tick = std::max(follower_.NextTick(now), now + milliseconds(1));
      }
      is_changed = follower_.version() != version_;
      // The first change after a pause at once, and many in a row together.
      if (is_changed && now >= next_publish) {
        next_publish = now + kPublishInterval;
        is_changed = false;
        view = follower_.View();
        version_ = follower_.version();
      }
    }
    for (const ReplicationMessage& message : messages) {
      const std::string channel = ChannelOf(message, channel_prefix_);
      bus_->PublishBytes(channel, Signed(keys_.get(), channel, EncodeReplication(message)));
    }
    if (view) Publish(std::move(view));
  }
}

void MapReplica::Impl::Publish(std::shared_ptr<const MapView> view) {
  const std::shared_ptr<const MapView> before = map_.View();
  map_.Use(view);
  if (!on_change_) return;
  const std::optional<Region> changed = ChangedRegion(*before, *view);
  if (changed) on_change_(*view, *changed);
}

absl::StatusOr<std::unique_ptr<MapReplica>> MapReplica::Follow(const std::string& url,
                                                               FollowOptions options,
                                                               OnChange on_change) {
  SPLINEMAP_ASSIGN_OR_RETURN(std::unique_ptr<LcmBus> bus, LcmBus::Open(url));
  return std::unique_ptr<MapReplica>(new MapReplica(
      std::make_unique<Impl>(std::move(bus), std::move(options), std::move(on_change))));
}

MapReplica::MapReplica(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
MapReplica::~MapReplica() = default;

std::shared_ptr<const MapView> MapReplica::View() const { return impl_->View(); }

absl::StatusOr<AnyAnswer> MapReplica::AskAny(const AnyQuery& query) const {
  return impl_->map().AskAny(query);
}

LayerSet MapReplica::Layers() const {
  return impl_->OfFollower([](MapFollower& follower) { return follower.Layers(); });
}

LayerSet MapReplica::SyncedLayers() const {
  return impl_->OfFollower([](MapFollower& follower) { return follower.SyncedLayers(); });
}

std::vector<FollowedLayer> MapReplica::FollowedLayers() const {
  return impl_->OfFollower(
      [](MapFollower& follower) { return follower.FollowedLayers(Clock::now()); });
}

bool MapReplica::IsCaughtUp() const {
  return impl_->OfFollower([](MapFollower& follower) { return follower.IsCaughtUp(Clock::now()); });
}

std::vector<std::string> MapReplica::Refused() const {
  return impl_->OfFollower([](MapFollower& follower) { return follower.refused(); });
}

std::vector<std::string> MapReplica::Disbelieved() const {
  return impl_->OfFollower([](MapFollower& follower) {
    std::vector<std::string> disbelieved;
    for (const auto& [code, messages] : follower.admission().disbelieved()) {
      disbelieved.push_back(fmt::format("{} messages: {}", messages.count, messages.why));
    }
    return disbelieved;
  });
}

int64_t MapReplica::BytesReceived() const {
  return impl_->OfFollower([](MapFollower& follower) { return follower.bytes_received(); });
}

std::string MapReplica::BusProblem() const { return impl_->bus().Problem(); }

}  // namespace splinemap
