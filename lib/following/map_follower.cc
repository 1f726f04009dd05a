#include "lib/following/map_follower.h"

#include <fnmatch.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

#include "fmt/format.h"
#include "lib/replication/channels.h"
#include "lib/wire/decode.h"
#include "lib/wire/encode.h"

namespace splinemap {
namespace {

using std::chrono::milliseconds;

constexpr size_t kMaxLayers = 256;
constexpr size_t kMaxRefused = 16;
constexpr size_t kMaxOwnListings = 64;  // of what may still be under way
// A layer that nobody has spoken for in so long is not said to be in sync.
constexpr double kMaxSilence_s = 3.5;
// Who does not keep layers leaves it to those who do to stand in.
constexpr milliseconds kPatience(8000);
// A layer of a name that another one has taken is forgotten after that, and one without tiles.
constexpr double kForgetAfter_s = 10;
// What a digest says of knot interval and limits counts for so long.
constexpr double kToldLately_s = 5;

double Seconds(Clock::duration duration) { return std::chrono::duration<double>(duration).count(); }

std::string Differences(const MapOptions& theirs, const MapOptions& ours) {
  if (theirs.knot_interval_m != ours.knot_interval_m) {
    return fmt::format("its knot interval is {} m, and {} m here", theirs.knot_interval_m,
                       ours.knot_interval_m);
  }
  const auto log_odds = [](ControlPoint c) { return c / double{kUnitsPerLogOdds}; };
  return fmt::format("its control points are clamped to {} .. {}, and to {} .. {} here",
                     log_odds(theirs.limits.min), log_odds(theirs.limits.max),
                     log_odds(ours.limits.min), log_odds(ours.limits.max));
}

}  // namespace

bool MatchesName(const std::string& pattern, const std::string& name) {
  return fnmatch(pattern.c_str(), name.c_str(), 0) == 0;
}

MapFollower::MapFollower(FollowOptions options, uint64_t seed)
    : options_(std::move(options)), nonce_(seed), seed_(seed), gossip_({}, seed) {}

MapFollower::MapFollower(FollowOptions options, Keeper keeper, const MapSnapshot& kept,
                         uint64_t seed, Clock::time_point now)
    : options_(std::move(options)),
      keeper_(std::move(keeper)),
      nonce_(keeper_->daemon_nonce),
      seed_(seed),
      map_options_(keeper_->map_options),
      gossip_(kept.controls, seed) {
  for (const LayerSnapshot& layer : kept.layers) {
    if (layer.id == keeper_->own_layer || controls().Of(layer.id).IsRemoved(layer.epoch)) continue;
    Add(layer.id, LayerFollower(layer, ++seed_, now));
  }
}

std::vector<std::string> MapFollower::Channels() const {
  std::vector<std::string> channels;
  for (const char* channel : kFollowedChannels) {
    channels.push_back(options_.channel_prefix + channel);
  }
  return channels;
}

void MapFollower::HandleMessage(absl::Span<const uint8_t> message, Clock::time_point now) {
  bytes_received_ += std::ssize(message);
  // Channels may carry anything; what a message is, it says itself.
  bool is_good = false;
  const auto take = [&](const auto& decoded, const auto& act) {
    is_good = decoded.ok();
    if (is_good) act(*decoded);
  };
  // What is left of the memory is anybody's.
  const auto copy_of = [&](const layer_epoch_t& layer) -> LayerFollower* {
    Followed* followed = Find(layer);
    if (followed == nullptr) return nullptr;
    const size_t others = NumTiles() - followed->copy.num_tiles();
    followed->copy.SetMaxTiles(options_.max_tiles - std::min(others, options_.max_tiles));
    return &followed->copy;
  };
  switch (TypeOf(message).value_or(MessageType::kStatus)) {
    case MessageType::kLayerDigest:
      take(DecodeLayerDigest(message), [&](const auto& digest) { TakeDigest(digest, now); });
      break;
    case MessageType::kStandInDigest:
      take(DecodeStandInDigest(message),
           [&](const auto& stand_in) { TakeStandInDigest(stand_in, now); });
      break;
    case MessageType::kLayerUpdates:
      take(DecodeLayerUpdates(message), [&](const auto& updates) {
        if (LayerFollower* copy = copy_of(updates.layer)) copy->TakeUpdates(updates);
      });
      break;
    case MessageType::kLayerListing:
      is_good = IsOwnListing(message);
      if (is_good) break;
      take(DecodeLayerListing(message), [&](const auto& listing) {
        if (LayerFollower* copy = copy_of(listing.layer)) copy->TakeListing(listing, now);
      });
      break;
    case MessageType::kLayerPull:
      take(DecodeLayerPull(message), [&](const auto& pull) { TakePull(pull, now); });
      break;
    case MessageType::kControlRecords:
      take(DecodeControlRecords(message), [&](const auto& records) {
        if (!options_.takes_decisions) {
          ignored_decisions_ += gossip_.CountNews(records);
          return;
        }
        const LayerControls before = controls();
        const auto incarnation_of = [&](const LayerId& id) { return IncarnationOf(id); };
        if (gossip_.Take(records, incarnation_of, now)) ObeyControls(before);
      });
      break;
    default:
      break;
  }
  malformed_ += is_good ? 0 : 1;
}

// Of two stand-ins of one revision each asks what the other one has; its own answer comes back
// first and would tell it that nothing differs.
bool MapFollower::IsOwnListing(absl::Span<const uint8_t> message) const {
  return std::any_of(own_listings_.begin(), own_listings_.end(),
                     [&](const std::vector<uint8_t>& own) { return message == own; });
}

MapFollower::Followed* MapFollower::Find(const layer_epoch_t& layer) {
  const auto found = layers_.find(FromMessage(layer).id);
  return found == layers_.end() ? nullptr : &found->second;
}

LayerFollower::Part MapFollower::PartFor(const LayerId& id) const {
  LayerFollower::Part part;
  part.detail = options_.detail;
  if (options_.region) {
    // Layers are shifted by knots of level 0, and the region is of the map frame.
    const double fine_m = std::ldexp(map_options_->knot_interval_m, -options_.detail.level);
    const KnotShift shift = controls().Of(id).shift;
    const Region& region = *options_.region;
    part.box = TilesOf({region.x0_m - shift.i * fine_m, region.y0_m - shift.j * fine_m,
                        region.x1_m - shift.i * fine_m, region.y1_m - shift.j * fine_m},
                       map_options_->knot_interval_m);
  }
  return part;
}

void MapFollower::Add(const LayerId& id, LayerFollower copy) {
  ++version_;
  Followed& followed = layers_.try_emplace(id, Followed{std::move(copy), nullptr}).first->second;
  if (options_.region || options_.detail != Detail{}) return;
  PublisherOptions publisher = keeper_ ? keeper_->publisher : PublisherOptions();
  publisher.bytes_per_s /= static_cast<double>(layers_.size());
  followed.stand_in = std::make_unique<StandIn>(
      followed.copy, keeper_ ? milliseconds(0) : kPatience, nonce_, *map_options_, publisher);
}

std::optional<uint64_t> MapFollower::IncarnationOf(const LayerId& id) const {
  if (keeper_ && id == keeper_->own_layer) return keeper_->own_incarnation;
  const auto layer = layers_.find(id);
  if (layer == layers_.end()) return std::nullopt;
  return layer->second.copy.epoch().incarnation;
}

bool MapFollower::IsWanted(const LayerLife& life, int32_t protocol_version) {
  const std::optional<uint64_t> known = IncarnationOf(life.id);
  if (known && *known > 0 && life.epoch.incarnation > *known + LayerControl::kMaxStartsAhead) {
    ++malformed_;
    return false;
  }
  const auto matches = [&](const std::string& pattern) {
    return MatchesName(pattern, life.id.name);
  };
  const std::vector<std::string>& names = options_.names;
  if (!names.empty() && std::none_of(names.begin(), names.end(), matches)) return false;
  if (keeper_ && life.id == keeper_->own_layer) return false;
  if (gossip_.SetHere(life.id, std::max(life.epoch.incarnation, known.value_or(0)))) ++version_;
  if (controls().Of(life.id).IsRemoved(life.epoch)) return false;
  if (protocol_version != kProtocolVersion) {
    Refuse(life.id, fmt::format("it speaks version {} of the protocol, and this is version {}",
                                protocol_version, kProtocolVersion));
    return false;
  }
  return true;
}

// A layer begins to exist with its digest, which says how to read it.
LayerFollower* MapFollower::FindOrAdd(const layer_digest_t& digest, Clock::time_point now) {
  const LayerLife life = FromMessage(digest.layer);
  if (!IsWanted(life, digest.protocol_version)) return nullptr;
  const MapOptions map_options{std::ldexp(digest.knot_interval_m, options_.detail.level),
                               {static_cast<ControlPoint>(digest.min_control_point),
                                static_cast<ControlPoint>(digest.max_control_point)}};
  if (!keeper_) ChooseOptions(life.id, map_options, now);
  if (map_options != *map_options_) {
    Refuse(life.id, Differences(map_options, *map_options_));
    return nullptr;
  }
  if (Followed* followed = Find(digest.layer)) return &followed->copy;
  if (layers_.size() >= kMaxLayers && !MakeRoom(now)) {
    Refuse(life.id, fmt::format("{} layers are followed already", kMaxLayers));
    return nullptr;
  }
  Add(life.id, LayerFollower(life.id, ++seed_, PartFor(life.id)));
  refused_.erase(life.id);
  return &Find(digest.layer)->copy;
}

// A tie is for what is there. Nobody who speaks first, or for one layer alone, decides for others.
void MapFollower::ChooseOptions(const LayerId& id, const MapOptions& options,
                                Clock::time_point now) {
  std::erase_if(told_,
                [&](const auto& told) { return Seconds(now - told.second.when) > kToldLately_s; });
  if (told_.contains(id) || told_.size() < kMaxLayers) told_[id] = {options, now};
  const auto votes_for = [&](const MapOptions& other) {
    return std::count_if(told_.begin(), told_.end(),
                         [&](const auto& told) { return told.second.options == other; });
  };
  if (map_options_ && votes_for(options) <= votes_for(*map_options_)) return;
  if (!std::exchange(map_options_, options)) return;
  while (!layers_.empty()) Erase(layers_.begin());
  refused_.clear();
  merged_ = {};
}

// For a layer without tiles there is no loss in being heard of again.
bool MapFollower::MakeRoom(Clock::time_point now) {
  auto least = layers_.end();
  for (auto layer = layers_.begin(); layer != layers_.end(); ++layer) {
    if (!layer->second.copy.IsEmpty()) continue;
    if (least == layers_.end() ||
        layer->second.copy.last_spoken_for() < least->second.copy.last_spoken_for()) {
      least = layer;
    }
  }
  if (least == layers_.end()) return false;
  gossip_.SetStranger(least->first, now);
  Erase(least);
  return true;
}

void MapFollower::TakeDigest(const layer_digest_t& digest, Clock::time_point now) {
  LayerFollower* copy = FindOrAdd(digest, now);
  if (copy == nullptr) return;
  copy->TakeDigest(digest, now);
  ForgetReplaced(FromMessage(digest.layer).id, now);
}

void MapFollower::TakeStandInDigest(const stand_in_digest_t& stand_in, Clock::time_point now) {
  if (static_cast<uint64_t>(stand_in.daemon_nonce) == nonce_) return;
  LayerFollower* copy = FindOrAdd(stand_in.digest, now);
  if (copy == nullptr) return;
  copy->TakeStandInDigest(stand_in, now);
  Followed* followed = Find(stand_in.digest.layer);
  if (followed->stand_in) followed->stand_in->TakeDigest(stand_in, now);
  ForgetReplaced(FromMessage(stand_in.digest.layer).id, now);
}

void MapFollower::TakePull(const layer_pull_t& pull, Clock::time_point now) {
  Followed* followed = Find(pull.layer);
  if (followed == nullptr) return;
  followed->copy.TakePull(pull, now);
  if (followed->stand_in) followed->stand_in->TakePull(pull, now);
}

bool MapFollower::HasNamesake(const LayerId& id) const {
  return std::any_of(layers_.begin(), layers_.end(), [&](const auto& other) {
    return other.first.name == id.name && other.first != id;
  });
}

void MapFollower::ForgetReplaced(const LayerId& speaker, Clock::time_point now) {
  if (keeper_ || !layers_.at(speaker).copy.in_sync()) return;
  for (auto entry = layers_.begin(); entry != layers_.end();) {
    const auto& [id, followed] = *entry;
    const bool is_replaced = id.name == speaker.name && id != speaker &&
                             Seconds(now - followed.copy.last_spoken_for()) > kForgetAfter_s;
    entry = is_replaced ? Erase(entry) : std::next(entry);
  }
}

std::map<LayerId, MapFollower::Followed>::iterator MapFollower::Erase(
    std::map<LayerId, Followed>::iterator layer) {
  version_ += layer->second.copy.version() + 1;
  return layers_.erase(layer);
}

uint64_t MapFollower::version() const {
  uint64_t version = version_;
  for (const auto& [id, followed] : layers_) version += followed.copy.version();
  return version;
}

void MapFollower::Decide(const LayerId& id, const LayerControl& control) {
  const LayerControls before = controls();
  gossip_.Decide(id, control);
  ObeyControls(before);
}

// Drops what is removed; of a region, other tiles of a layer are needed when its shift changes.
void MapFollower::ObeyControls(const LayerControls& before) {
  ++version_;
  std::vector<LayerId> shifted;
  for (auto entry = layers_.begin(); entry != layers_.end();) {
    const LayerId& id = entry->first;
    LayerFollower& copy = entry->second.copy;
    const LayerControl& control = controls().Of(id);
    if (copy.ShowsPreviousLife() && control.IsRemoved(copy.Snapshot().epoch)) {
      copy.ForgetPreviousLife();
    }
    const bool is_removed = copy.epoch() != LayerEpoch{} && control.IsRemoved(copy.epoch());
    const bool is_shifted = options_.region && control.shift != before.Of(id).shift;
    if (is_shifted && !is_removed) shifted.push_back(id);
    entry = is_removed || is_shifted ? Erase(entry) : std::next(entry);
  }
  for (const LayerId& id : shifted) Add(id, LayerFollower(id, ++seed_, PartFor(id)));
}

void MapFollower::SetOwnLayer(LayerId id, uint64_t incarnation) {
  if (const auto layer = layers_.find(id); layer != layers_.end()) Erase(layer);
  keeper_->own_layer = std::move(id);
  keeper_->own_incarnation = incarnation;
}

void MapFollower::Refuse(const LayerId& id, std::string why) {
  if (refused_.size() < kMaxRefused) refused_.emplace(id, std::move(why));
}

std::vector<std::string> MapFollower::refused() const {
  std::vector<std::string> refused;
  for (const auto& [id, why] : refused_) refused.push_back(fmt::format("{}: {}", id.name, why));
  return refused;
}

std::vector<MapFollower::Message> MapFollower::Tick(Clock::time_point now) {
  std::vector<Message> messages;
  for (auto entry = layers_.begin(); entry != layers_.end();) {
    const LayerFollower& copy = entry->second.copy;
    const bool is_gone = copy.IsEmpty() && Seconds(now - copy.last_spoken_for()) > kForgetAfter_s;
    if (is_gone) gossip_.SetStranger(entry->first, now);
    entry = is_gone ? Erase(entry) : std::next(entry);
  }
  for (auto& [id, followed] : layers_) {
    for (layer_pull_t& pull : followed.copy.Tick(now)) messages.emplace_back(std::move(pull));
    if (!followed.stand_in) continue;
    // What a namesake has replaced can be forgotten.
    const bool may_begin = keeper_ || !HasNamesake(id);
    for (StandIn::Message& message : followed.stand_in->Tick(now, may_begin)) {
      if (const auto* listing = std::get_if<layer_listing_t>(&message)) {
        own_listings_.push_back(Encode(*listing));
        if (own_listings_.size() > kMaxOwnListings) own_listings_.pop_front();
      }
      std::visit([&](auto& m) { messages.emplace_back(std::move(m)); }, message);
    }
  }
  if (!options_.takes_decisions) return messages;
  for (control_records_t& records : gossip_.Tick(now)) messages.emplace_back(std::move(records));
  return messages;
}

LayerControls MapFollower::SummedControls() const {
  if (options_.detail.level == 0) return controls();
  LayerControls coarse;
  for (auto [id, control] : controls().records()) {
    const auto round = [&](int32_t knots) {
      return static_cast<int32_t>(std::lround(std::ldexp(knots, -options_.detail.level)));
    };
    control.shift = {round(control.shift.i), round(control.shift.j)};
    coarse.Take(id, control);
  }
  return coarse;
}

std::vector<LayerSnapshot> MapFollower::LayerSnapshots() {
  std::vector<LayerSnapshot> layers;
  for (auto& [id, followed] : layers_) {
    LayerSnapshot layer = followed.copy.Snapshot();
    if (layer.epoch != LayerEpoch{}) layers.push_back(std::move(layer));
  }
  return layers;
}

std::shared_ptr<const MapSnapshot> MapFollower::Snapshot() {
  auto snapshot = std::make_shared<MapSnapshot>();
  if (map_options_) snapshot->options = *map_options_;
  snapshot->layers = LayerSnapshots();
  snapshot->controls = SummedControls();
  snapshot->merged = merged_.Update(snapshot->layers, snapshot->controls, snapshot->options.limits);
  return snapshot;
}

std::shared_ptr<const MapSnapshot> MapFollower::WholeSnapshot() const {
  auto snapshot = std::make_shared<MapSnapshot>();
  if (map_options_) snapshot->options = *map_options_;
  for (const auto& [id, followed] : layers_) {
    if (followed.copy.whole()) snapshot->layers.push_back(*followed.copy.whole());
  }
  snapshot->controls = SummedControls();
  snapshot->merged =
      MergedTiles().Update(snapshot->layers, snapshot->controls, snapshot->options.limits);
  return snapshot;
}

std::vector<FollowedLayer> MapFollower::Layers(Clock::time_point now) const {
  std::vector<FollowedLayer> layers;
  for (const auto& [id, followed] : layers_) {
    const LayerFollower& copy = followed.copy;
    const auto match = copy.last_match();
    const double since_match_s =
        match ? Seconds(now - *match) : std::numeric_limits<double>::infinity();
    layers.push_back({id, copy.epoch(), copy.revision(), copy.num_tiles(), copy.hash(),
                      copy.is_equal(), copy.in_sync() && since_match_s < kMaxSilence_s,
                      1000 * (since_match_s + copy.lag_s()),
                      copy.OwnerWasHeard() ? Seconds(now - copy.last_heard()) : -1,
                      copy.OwnerIsSilent(now), copy.counts()});
  }
  return layers;
}

size_t MapFollower::NumTiles() const {
  size_t tiles = 0;
  for (const auto& [id, followed] : layers_) tiles += followed.copy.num_tiles();
  return tiles;
}

}  // namespace splinemap
