#include "services/splinemapd/layer_server.h"

#include <utility>

#include "lib/replication/channels.h"
#include "lib/wire/decode.h"

namespace splinemap {
namespace {

constexpr std::chrono::milliseconds kServerTick(5);
// More than that in one tick are asked for again.
constexpr size_t kMaxPullsWaiting = 1000;

}  // namespace

LayerServer::LayerServer(LcmBus& bus, const std::string& channel_prefix,
                         const PublisherOptions& options, TakeSnapshot take_snapshot)
    : bus_(bus),
      prefix_(channel_prefix),
      take_snapshot_(std::move(take_snapshot)),
      options_(options),
      serving_([this](const std::stop_token& stop) { Serve(stop); }) {}

void LayerServer::TakePull(absl::Span<const uint8_t> message) {
  absl::StatusOr<layer_pull_t> pull = DecodeLayerPull(message);
  if (!pull.ok()) return;
  MutexLock lock(mutex_);
  if (pulls_.size() < kMaxPullsWaiting) pulls_.push_back(*std::move(pull));
}

void LayerServer::Serve(const std::stop_token& stop) {
  bool is_last = false;
  while (!is_last) {
    is_last = stop.stop_requested();
    std::this_thread::sleep_for(kServerTick);
    std::vector<layer_pull_t> pulls;
    {
      MutexLock lock(mutex_);
      pulls.swap(pulls_);
    }
    const Clock::time_point now = Clock::now();
    SetLayer(*take_snapshot_(), now);
    for (const layer_pull_t& pull : pulls) publisher_->TakePull(pull, now);
    // At the end what waits goes out, as far as the limit allows, and a last digest.
    const auto messages = is_last ? publisher_->LastTick(now) : publisher_->Tick(now);
    for (const PublishedMessage& message : messages) Publish(message);
  }
}

void LayerServer::SetLayer(const MapSnapshot& map, Clock::time_point now) {
  const LayerSnapshot& layer = map.layers.front();
  const LayerLife life{layer.id, layer.epoch, {}};
  if (publisher_ && life == life_) {
    publisher_->SetLayer(layer, now);
    return;
  }
  life_ = life;
  publisher_ = std::make_unique<LevelsPublisher>(layer, map.options, options_);
}

void LayerServer::Publish(const PublishedMessage& message) {
  std::visit([&](const auto& m) { bus_.Publish(prefix_ + ChannelOf(m), m); }, message);
}

}  // namespace splinemap
