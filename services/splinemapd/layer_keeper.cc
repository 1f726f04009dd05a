#include "services/splinemapd/layer_keeper.h"

#include <utility>

#include "lib/base/random.h"
#include "lib/replication/channels.h"

namespace splinemap {
namespace {

constexpr std::chrono::milliseconds kTick(10);
constexpr size_t kMaxQueuedBytes = size_t{16} << 20;

}  // namespace

LayerKeeper::LayerKeeper(LcmBus& bus, FollowOptions options, Keeper keeper, const MapSnapshot& kept,
                         SummedMap& sum)
    : bus_(bus),
      channel_prefix_(options.channel_prefix),
      sum_(sum),
      queue_(kMaxQueuedBytes),
      follower_(std::move(options), std::move(keeper), kept, RandomId(), Clock::now()) {
  {
    MutexLock lock(mutex_);
    Show();
  }
  running_ = std::jthread([this](const std::stop_token& stop) { Run(stop); });
}

std::vector<std::string> LayerKeeper::Channels() const {
  MutexLock lock(mutex_);
  return follower_.Channels();
}

void LayerKeeper::Run(const std::stop_token& stop) {
  while (!stop.stop_requested()) {
    auto message = queue_.Pop(kTick);
    std::vector<MapFollower::Message> messages;
    {
      MutexLock lock(mutex_);
      // What one commit changed comes in several messages, which are shown together.
      for (const auto end = Clock::now() + kTick; message && Clock::now() < end;) {
        follower_.HandleMessage(message->bytes, Clock::now());
        message = queue_.Pop(std::chrono::milliseconds(0));
      }
      if (message) follower_.HandleMessage(message->bytes, Clock::now());
      messages = follower_.Tick(Clock::now());
      Show();
    }
    for (const MapFollower::Message& outgoing : messages) {
      std::visit([&](const auto& m) { bus_.Publish(channel_prefix_ + ChannelOf(m), m); }, outgoing);
    }
  }
}

void LayerKeeper::Show() {
  if (shown_ == follower_.version()) return;
  shown_ = follower_.version();
  sum_.SetFollowed(follower_.LayerSnapshots(), follower_.LastingControls());
}

void LayerKeeper::Decide(const LayerId& id, const LayerControl& control) {
  MutexLock lock(mutex_);
  follower_.Decide(id, control);
  Show();
}

LayerControls LayerKeeper::Controls() const {
  MutexLock lock(mutex_);
  return follower_.controls();
}

std::vector<FollowedLayer> LayerKeeper::Layers() const {
  MutexLock lock(mutex_);
  return follower_.Layers(Clock::now());
}

std::vector<std::string> LayerKeeper::Refused() const {
  MutexLock lock(mutex_);
  return follower_.refused();
}

int64_t LayerKeeper::RefusedDecisions() const {
  MutexLock lock(mutex_);
  return follower_.refused_decisions();
}

int64_t LayerKeeper::IgnoredDecisions() const {
  MutexLock lock(mutex_);
  return follower_.ignored_decisions();
}

bool LayerKeeper::IsFull() const {
  MutexLock lock(mutex_);
  return follower_.is_full();
}

void LayerKeeper::SetOwnLayer(const LayerId& id, uint64_t incarnation) {
  MutexLock lock(mutex_);
  follower_.SetOwnLayer(id, incarnation);
  Show();
}

}  // namespace splinemap
