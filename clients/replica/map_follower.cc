#include "clients/replica/map_follower.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

#include "lib/wire/decode.h"

namespace splinemap {
namespace {

constexpr size_t kMaxLayers = 256;
constexpr size_t kMaxRefused = 16;
// An owner that has said nothing for so long is gone.
constexpr double kMaxSilence_s = 3.5;
// A layer of a name that another one has taken is forgotten after that.
constexpr double kForgetAfter_s = 10;

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

void MapFollower::HandleMessage(absl::Span<const uint8_t> message, Clock::time_point now) {
  bytes_received_ += std::ssize(message);
  // Channels may carry anything; what a message is, it says itself.
  bool is_good = false;
  switch (TypeOf(message).value_or(MessageType::kStatus)) {
    case MessageType::kLayerDigest:
      if (const auto digest = DecodeLayerDigest(message); (is_good = digest.ok())) {
        TakeDigest(*digest, now);
      }
      break;
    case MessageType::kLayerUpdates:
      if (const auto updates = DecodeLayerUpdates(message); (is_good = updates.ok())) {
        if (LayerFollower* layer = Find(updates->layer)) layer->TakeUpdates(*updates);
      }
      break;
    case MessageType::kLayerListing:
      if (const auto listing = DecodeLayerListing(message); (is_good = listing.ok())) {
        if (LayerFollower* layer = Find(listing->layer)) layer->TakeListing(*listing, now);
      }
      break;
    case MessageType::kLayerPull:
      if (const auto pull = DecodeLayerPull(message); (is_good = pull.ok())) {
        if (LayerFollower* layer = Find(pull->layer)) layer->TakePull(*pull, now);
      }
      break;
    default:
      break;
  }
  malformed_ += is_good ? 0 : 1;
}

LayerFollower* MapFollower::Find(const layer_epoch_t& layer) {
  const auto found = layers_.find(FromMessage(layer).id);
  return found == layers_.end() ? nullptr : &found->second;
}

// A layer begins to exist with its digest, which says how to read it.
void MapFollower::TakeDigest(const layer_digest_t& digest, Clock::time_point now) {
  const LayerLife life = FromMessage(digest.layer);
  if (life.epoch.incarnation > LayerEpoch::kMaxIncarnation) {
    ++malformed_;
    return;
  }
  const LayerId& id = life.id;
  const std::vector<std::string>& names = options_.names;
  if (!names.empty() && std::find(names.begin(), names.end(), id.name) == names.end()) return;
  if (digest.protocol_version != kProtocolVersion) {
    Refuse(id.name);
    return;
  }
  const MapOptions map_options{std::ldexp(digest.knot_interval_m, options_.detail.level),
                               {static_cast<ControlPoint>(digest.min_control_point),
                                static_cast<ControlPoint>(digest.max_control_point)}};
  if (!map_options_) map_options_ = map_options;
  if (map_options != *map_options_) {
    Refuse(id.name);
    return;
  }
  LayerFollower* layer = Find(digest.layer);
  if (layer == nullptr) {
    if (layers_.size() >= kMaxLayers) {
      Refuse(id.name);
      return;
    }
    LayerFollower::Part part;
    part.detail = options_.detail;
    part.max_tiles = options_.max_tiles_per_layer;
    if (options_.region) part.box = TilesOf(*options_.region, map_options.knot_interval_m);
    layer = &layers_.try_emplace(id, id, ++seed_, part).first->second;
  }
  layer->TakeDigest(digest, now);
  ForgetReplaced(id, now);
}

void MapFollower::ForgetReplaced(const LayerId& speaker, Clock::time_point now) {
  if (!layers_.at(speaker).in_sync()) return;
  const size_t forgotten = std::erase_if(layers_, [&](const auto& entry) {
    const auto& [id, layer] = entry;
    const std::chrono::duration<double> silence = now - layer.last_heard();
    return id.name == speaker.name && id != speaker && silence.count() > kForgetAfter_s;
  });
  if (forgotten > 0) merged_ = MergedTiles();
}

void MapFollower::Refuse(const std::string& name) {
  const bool is_known = std::find(refused_.begin(), refused_.end(), name) != refused_.end();
  if (!is_known && refused_.size() < kMaxRefused) refused_.push_back(name);
}

std::vector<layer_pull_t> MapFollower::Tick(Clock::time_point now) {
  std::vector<layer_pull_t> pulls;
  for (auto& [id, layer] : layers_) {
    for (layer_pull_t& pull : layer.Tick(now)) pulls.push_back(std::move(pull));
  }
  return pulls;
}

std::shared_ptr<const MapSnapshot> MapFollower::Snapshot() {
  auto snapshot = std::make_shared<MapSnapshot>();
  if (map_options_) snapshot->options = *map_options_;
  for (auto& [id, layer] : layers_) snapshot->layers.push_back(layer.Snapshot());
  if (!layers_.empty()) {
    snapshot->merged = merged_.Update(snapshot->layers, snapshot->controls, snapshot->options.limits);
  }
  return snapshot;
}

std::shared_ptr<const MapSnapshot> MapFollower::WholeSnapshot() const {
  auto snapshot = std::make_shared<MapSnapshot>();
  if (map_options_) snapshot->options = *map_options_;
  for (const auto& [id, layer] : layers_) {
    if (layer.whole()) snapshot->layers.push_back(*layer.whole());
  }
  if (!snapshot->layers.empty()) {
    snapshot->merged = MergedTiles().Update(snapshot->layers, snapshot->controls, snapshot->options.limits);
  }
  return snapshot;
}

std::vector<FollowedLayer> MapFollower::Layers(Clock::time_point now) const {
  std::vector<FollowedLayer> layers;
  for (const auto& [id, layer] : layers_) {
    const auto match = layer.last_match();
    const double since_match_s = match ? std::chrono::duration<double>(now - *match).count()
                                       : std::numeric_limits<double>::infinity();
    layers.push_back({id, layer.epoch(), layer.revision(), layer.num_tiles(), layer.is_equal(),
                      layer.in_sync() && since_match_s < kMaxSilence_s,
                      1000 * (since_match_s + layer.lag_s()), layer.counts()});
  }
  return layers;
}

}  // namespace splinemap
