#include "clients/replica/map_follower.h"

#include <algorithm>
#include <limits>
#include <utility>

#include "lib/wire/decode.h"

namespace splinemap {
namespace {

constexpr size_t kMaxLayers = 256;
constexpr size_t kMaxRefused = 16;

}  // namespace

MapFollower::MapFollower(FollowOptions options, uint64_t seed)
    : options_(std::move(options)), seed_(seed) {}

std::vector<std::string> MapFollower::Channels() const {
  std::vector<std::string> channels;
  for (const char* suffix : {"_DIGESTS", "_UPDATES", "_LISTINGS", "_PULLS"}) {
    channels.push_back(options_.channel_prefix + suffix);
  }
  return channels;
}

void MapFollower::HandleMessage(const std::string&, absl::Span<const uint8_t> message,
                                Clock::time_point now) {
  bytes_received_ += std::ssize(message);
  // A channel may carry anything; what a message is, it says itself.
  if (const auto digest = DecodeLayerDigest(message); digest.ok()) {
    TakeDigest(*digest, now);
  } else if (const auto updates = DecodeLayerUpdates(message); updates.ok()) {
    if (Followed* layer = Find(updates->layer)) layer->follower.TakeUpdates(*updates);
  } else if (const auto listing = DecodeLayerListing(message); listing.ok()) {
    if (Followed* layer = Find(listing->layer)) layer->follower.TakeListing(*listing, now);
  } else if (const auto pull = DecodeLayerPull(message); pull.ok()) {
    if (Followed* layer = Find(pull->layer)) layer->follower.TakePull(*pull, now);
  } else {
    ++malformed_;
  }
}

MapFollower::Followed* MapFollower::Find(const layer_epoch_t& layer) {
  const auto found = layers_.find(FromMessage(layer).id);
  return found == layers_.end() ? nullptr : &found->second;
}

// A layer begins to exist with its digest, which says how to read it.
void MapFollower::TakeDigest(const layer_digest_t& digest, Clock::time_point now) {
  const LayerId id = FromMessage(digest.layer).id;
  const std::vector<std::string>& names = options_.names;
  if (!names.empty() && std::find(names.begin(), names.end(), id.name) == names.end()) return;
  const MapOptions map_options{digest.knot_interval_m,
                               {static_cast<ControlPoint>(digest.min_control_point),
                                static_cast<ControlPoint>(digest.max_control_point)}};
  if (!map_options_) map_options_ = map_options;
  if (map_options != *map_options_) {
    const bool is_known = std::find(refused_.begin(), refused_.end(), id.name) != refused_.end();
    if (!is_known && refused_.size() < kMaxRefused) refused_.push_back(id.name);
    return;
  }
  Followed* layer = Find(digest.layer);
  if (layer == nullptr) {
    if (layers_.size() >= kMaxLayers) return;
    layer = &layers_.try_emplace(id, LayerFollower(id, ++seed_)).first->second;
  }
  layer->follower.TakeDigest(digest, now);
  layer->lag_s = digest.lag_s;
}

std::vector<layer_pull_t> MapFollower::Tick(Clock::time_point now) {
  std::vector<layer_pull_t> pulls;
  for (auto& [id, layer] : layers_) {
    for (layer_pull_t& pull : layer.follower.Tick(now)) pulls.push_back(std::move(pull));
  }
  return pulls;
}

std::shared_ptr<const MapSnapshot> MapFollower::Snapshot() {
  auto snapshot = std::make_shared<MapSnapshot>();
  if (map_options_) snapshot->options = *map_options_;
  for (auto& [id, layer] : layers_) snapshot->layers.push_back(layer.follower.Snapshot());
  if (!layers_.empty()) {
    snapshot->merged = merged_.Update(snapshot->layers, snapshot->options.limits);
  }
  return snapshot;
}

std::shared_ptr<const MapSnapshot> MapFollower::WholeSnapshot() const {
  auto snapshot = std::make_shared<MapSnapshot>();
  if (map_options_) snapshot->options = *map_options_;
  for (const auto& [id, layer] : layers_) {
    if (layer.follower.whole()) snapshot->layers.push_back(*layer.follower.whole());
  }
  if (!snapshot->layers.empty()) {
    snapshot->merged = MergedTiles().Update(snapshot->layers, snapshot->options.limits);
  }
  return snapshot;
}

std::vector<FollowedLayer> MapFollower::Layers(Clock::time_point now) const {
  std::vector<FollowedLayer> layers;
  for (const auto& [id, layer] : layers_) {
    const LayerFollower& follower = layer.follower;
    const auto match = follower.last_match();
    const double since_match_s = match ? std::chrono::duration<double>(now - *match).count()
                                       : std::numeric_limits<double>::infinity();
    layers.push_back({id, follower.epoch(), follower.revision(), follower.num_tiles(),
                      follower.in_sync(), 1000 * (since_match_s + layer.lag_s), follower.counts()});
  }
  return layers;
}

}  // namespace splinemap
