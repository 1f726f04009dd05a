#include "lib/replication/map_follower.h"

#include <fnmatch.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

#include "fmt/format.h"
#include "lcmtypes/splinemap/layer_digest_t.hpp"
#include "lcmtypes/splinemap/layer_listing_t.hpp"
#include "lcmtypes/splinemap/layer_pull_t.hpp"
#include "lcmtypes/splinemap/layer_ref_t.hpp"
#include "lcmtypes/splinemap/layer_scans_t.hpp"
#include "lcmtypes/splinemap/layer_status_t.hpp"
#include "lcmtypes/splinemap/layer_updates_t.hpp"
#include "lcmtypes/splinemap/scan_pull_t.hpp"
#include "lcmtypes/splinemap/settings_t.hpp"
#include "lib/map/placed_tile.h"

namespace splinemap {
namespace {

using std::chrono::milliseconds;

constexpr size_t kMaxLayers = 256;
constexpr size_t kMaxRefused = 16;
// A layer that nobody has spoken for in so long is not said to be in sync.
constexpr double kMaxSilence_s = 3.5;
// Who does not keep layers leaves it to those who do to stand in.
constexpr milliseconds kProxyDelay(8000);
// A layer of a name that another one has taken is forgotten after that, and one without tiles.
constexpr double kForgetAfter_s = 10;
// Who begins to follow asks so often and at such intervals which layers there are.
constexpr int kCalls = 12;
constexpr milliseconds kCallInterval(150);
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

MapFollower::MapFollower(FollowOptions options, uint64_t speaker)
    : options_(std::move(options)),
      speaker_(speaker),
      admission_(options_.channel_prefix, options_.keys, speaker),
      seed_(speaker),
      gossip_({}, speaker),
      sum_(options_.level_of_detail) {}

MapFollower::MapFollower(FollowOptions options, KeeperOptions keeper, const LayerSet& kept,
                         uint64_t speaker, Clock::time_point now)
    : options_(std::move(options)),
      keeper_(std::move(keeper)),
      speaker_(speaker),
      admission_(options_.channel_prefix, options_.keys, speaker),
      seed_(speaker),
      gossip_(kept.settings, speaker),
      sum_(options_.level_of_detail) {
  UseOptions(keeper_->map_options);
  for (const LayerSnapshot& layer : kept.layers) {
    if (layer.id == keeper_->own_layer || settings().Of(layer.id).IsRemoved(layer.session))
      continue;
    Add(layer.id, LayerFollower(layer, ++seed_, now, folder_));
  }
}

void MapFollower::UseOptions(const MapOptions& options) {
  map_options_ = options;
  if (options_.takes_tiles) return;
  const double knot_interval_m =
      std::ldexp(options.knot_interval_m, -options_.level_of_detail.level);
  folder_ = std::make_shared<ScanFolder>(MapOptions{knot_interval_m, options.limits});
}

void MapFollower::HandleBytes(absl::Span<const uint8_t> message, Clock::time_point now) {
  bytes_received_ += std::ssize(message);
  if (const auto admitted = admission_.Admit(message)) Handle(admitted->content, now);
}

bool MapFollower::Handle(const ReplicationMessage& message, Clock::time_point now) {
  if (SpeakerOf(message) == speaker_) return false;
  std::visit([&](const auto& m) { Handle(m, now); }, message);
  return true;
}

void MapFollower::Handle(const layer_digest_t& digest, Clock::time_point now) {
  LayerFollower* copy = FindOrAdd(digest, now);
  if (copy == nullptr) return;
  CopyOf(digest.layer)->HandleDigest(digest, now);
  if (Followed* followed = Find(digest.layer); followed->proxy) {
    followed->proxy->HandleDigest(digest, now);
  }
  ForgetReplaced(FromMessage(digest.layer).id, now);
}

void MapFollower::Handle(const layer_updates_t& updates, Clock::time_point) {
  if (LayerFollower* copy = CopyOf(updates.layer)) copy->HandleUpdates(updates);
}

void MapFollower::Handle(const layer_listing_t& listing, Clock::time_point now) {
  if (LayerFollower* copy = CopyOf(listing.layer)) copy->HandleListing(listing, now);
}

void MapFollower::Handle(const layer_pull_t& pull, Clock::time_point now) {
  if (IsCall(pull)) {
    for (auto& [id, followed] : layers_) {
      if (followed.proxy) followed.proxy->HandlePull(pull, now);
    }
    return;
  }
  Followed* followed = Find(pull.layer);
  if (followed == nullptr) return;
  followed->copy.HandlePull(pull, now);
  if (followed->proxy) followed->proxy->HandlePull(pull, now);
}

void MapFollower::Handle(const layer_scans_t& scans, Clock::time_point now) {
  if (LayerFollower* copy = CopyOf(scans.layer)) copy->HandleScans(scans, now);
}

void MapFollower::Handle(const scan_pull_t& pull, Clock::time_point now) {
  Followed* followed = Find(pull.layer);
  if (followed == nullptr) return;
  followed->copy.HandleScanPull(pull, now);
  if (followed->proxy) followed->proxy->HandleScanPull(pull, now);
}

void MapFollower::Handle(const settings_t& message, Clock::time_point now) {
  if (!options_.takes_settings) {
    ignored_settings_ += gossip_.CountNews(message);
    return;
  }
  const SettingsTable before = settings();
  const auto session_number_of = [&](const LayerId& id) { return SessionNumberOf(id); };
  if (gossip_.HandleSettings(message, session_number_of, now)) ApplySettings(before);
}

void MapFollower::Handle(const layers_t& layers, Clock::time_point now) {
  std::erase_if(announced_, [&](const auto& announced) {
    return Seconds(now - announced.second.when) > kMaxSilence_s;
  });
  for (const layer_status_t& layer : layers.layers) {
    const LayerId id{layer.settings.name, static_cast<uint64_t>(layer.settings.origin)};
    if (layer.num_tiles == 0 || !IsFollowed(id)) continue;
    if (!announced_.contains(id) && announced_.size() >= kMaxLayers) continue;
    announced_[id] = {
        {static_cast<uint64_t>(layer.session_number), static_cast<uint64_t>(layer.session_nonce)},
        now};
  }
}

LayerFollower* MapFollower::CopyOf(const layer_ref_t& layer) {
  Followed* followed = Find(layer);
  if (followed == nullptr) return nullptr;
  ShareTiles(followed->copy);
  return &followed->copy;
}

// The rest of the tile budget is shared.
void MapFollower::ShareTiles(LayerFollower& copy) const {
  const size_t others = NumTiles() - copy.num_tiles();
  copy.SetMaxTiles(options_.max_tiles - std::min(others, options_.max_tiles));
}

MapFollower::Followed* MapFollower::Find(const layer_ref_t& layer) {
  const auto found = layers_.find(FromMessage(layer).id);
  return found == layers_.end() ? nullptr : &found->second;
}

std::optional<TileBox> MapFollower::BoxFor(const LayerId& id) const {
  if (!options_.region) return std::nullopt;
  const double knot_interval_m = map_options_->knot_interval_m;
  return TilesUnder(
      *options_.region,
      KnotPlacement(settings().Of(id).placement, knot_interval_m, options_.level_of_detail),
      knot_interval_m);
}

LayerFollower::Subset MapFollower::SubsetFor(const LayerId& id) const {
  LayerFollower::Subset subset{options_.level_of_detail, BoxFor(id)};
  if (!MakesLevels()) return subset;
  if (subset.box) subset.box = CoarserCopy::FinerBox(*subset.box, subset.level_of_detail.level);
  subset.level_of_detail = {};
  return subset;
}

LayerFollower MapFollower::NewCopy(const LayerId& id) {
  return LayerFollower(id, ++seed_, SubsetFor(id), folder_);
}

void MapFollower::Add(const LayerId& id, LayerFollower copy) {
  ++version_;
  copy.SetSigned(options_.keys != nullptr);
  Followed& followed = layers_.try_emplace(id, Followed{std::move(copy), nullptr}).first->second;
  if (MakesLevels()) followed.coarser.emplace(options_.level_of_detail, BoxFor(id));
  if (options_.region || options_.level_of_detail != LevelOfDetail{}) return;
  if (options_.keys != nullptr && !options_.keys->own().answers) return;
  PublisherOptions publisher;
  if (keeper_) publisher.digest_interval = keeper_->digest_interval;
  followed.proxy = std::make_unique<ProxyPublisher>(
      followed.copy, keeper_ ? milliseconds(0) : kProxyDelay, speaker_, *map_options_, publisher);
}

std::optional<uint64_t> MapFollower::SessionNumberOf(const LayerId& id) const {
  if (keeper_ && id == keeper_->own_layer) return keeper_->own_session_number;
  const auto layer = layers_.find(id);
  if (layer == layers_.end()) return std::nullopt;
  return layer->second.copy.session().number;
}

// Of another's layers, those that the options name.
bool MapFollower::IsFollowed(const LayerId& id) const {
  if (keeper_ && id == keeper_->own_layer) return false;
  const std::vector<std::string>& names = options_.names;
  return names.empty() || std::any_of(names.begin(), names.end(), [&](const std::string& pattern) {
           return MatchesName(pattern, id.name);
         });
}

bool MapFollower::IsWanted(const LayerRef& ref, int32_t protocol_version) {
  const std::optional<uint64_t> known = SessionNumberOf(ref.id);
  if (known && *known > 0 && ref.session.number > *known + LayerSettings::kMaxSessionsAhead) {
    ++malformed_;
    return false;
  }
  if (!IsFollowed(ref.id)) return false;
  if (gossip_.SetHere(ref.id, std::max(ref.session.number, known.value_or(0)))) ++version_;
  if (settings().Of(ref.id).IsRemoved(ref.session)) return false;
  if (protocol_version != kProtocolVersion) {
    Refuse(ref.id, fmt::format("it speaks version {} of the protocol, and this is version {}",
                               protocol_version, kProtocolVersion));
    return false;
  }
  return true;
}

// A layer begins to exist with its digest, which says how to read it.
LayerFollower* MapFollower::FindOrAdd(const layer_digest_t& digest, Clock::time_point now) {
  const LayerRef ref = FromMessage(digest.layer);
  if (!IsWanted(ref, digest.protocol_version)) return nullptr;
  const MapOptions map_options{std::ldexp(digest.knot_interval_m, options_.level_of_detail.level),
                               {static_cast<ControlPoint>(digest.min_control_point),
                                static_cast<ControlPoint>(digest.max_control_point)}};
  if (!keeper_) ChooseOptions(ref.id, map_options, now);
  if (map_options != *map_options_) {
    Refuse(ref.id, Differences(map_options, *map_options_));
    return nullptr;
  }
  if (Followed* followed = Find(digest.layer)) return &followed->copy;
  if (layers_.size() >= kMaxLayers && !MakeRoom(now)) {
    Refuse(ref.id, fmt::format("{} layers are followed already", kMaxLayers));
    return nullptr;
  }
  Add(ref.id, NewCopy(ref.id));
  refused_.erase(ref.id);
  return &Find(digest.layer)->copy;
}

bool MapFollower::Adopt(const LayerSnapshot& layer, Clock::time_point now) {
  if (!IsFollowed(layer.id) || settings().Of(layer.id).IsRemoved(layer.session)) return false;
  const std::optional<uint64_t> known = SessionNumberOf(layer.id);
  if (known && *known > 0 && layer.session.number > *known + LayerSettings::kMaxSessionsAhead) {
    return false;
  }
  auto followed = layers_.find(layer.id);
  if (followed == layers_.end()) {
    if (layers_.size() >= kMaxLayers && !MakeRoom(now)) {
      Refuse(layer.id, fmt::format("{} layers are followed already", kMaxLayers));
      return false;
    }
    if (gossip_.SetHere(layer.id, layer.session.number)) ++version_;
    Add(layer.id, NewCopy(layer.id));
    refused_.erase(layer.id);
    followed = layers_.find(layer.id);
  }
  ShareTiles(followed->second.copy);
  return followed->second.copy.Adopt(layer, now);
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
  const bool had_options = map_options_.has_value();
  UseOptions(options);
  if (!had_options) return;
  while (!layers_.empty()) Erase(layers_.begin());
  refused_.clear();
  sum_ = SummedLayers(options_.level_of_detail);
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

bool MapFollower::HasDuplicateName(const LayerId& id) const {
  return std::any_of(layers_.begin(), layers_.end(), [&](const auto& other) {
    return other.first.name == id.name && other.first != id;
  });
}

void MapFollower::ForgetReplaced(const LayerId& speaker, Clock::time_point now) {
  if (keeper_ || !layers_.at(speaker).copy.caught_up()) return;
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

void MapFollower::Set(const LayerId& id, const LayerSettings& setting) {
  const SettingsTable before = settings();
  gossip_.Set(id, setting);
  ApplySettings(before);
}

// Drops what is removed; of a region, other tiles of a layer are needed when it is placed anew.
void MapFollower::ApplySettings(const SettingsTable& before) {
  ++version_;
  std::vector<LayerId> moved;
  for (auto entry = layers_.begin(); entry != layers_.end();) {
    const LayerId& id = entry->first;
    LayerFollower& copy = entry->second.copy;
    const LayerSettings& setting = settings().Of(id);
    if (copy.ShowsPreviousSession() && setting.IsRemoved(copy.Snapshot().session)) {
      copy.ForgetPreviousSession();
    }
    const bool is_removed = copy.session() != SessionId{} && setting.IsRemoved(copy.session());
    const bool is_moved = options_.region && setting.placement != before.Of(id).placement;
    if (is_moved && !is_removed) moved.push_back(id);
    entry = is_removed || is_moved ? Erase(entry) : std::next(entry);
  }
  for (const LayerId& id : moved) Add(id, NewCopy(id));
}

void MapFollower::SetOwnLayer(LayerId id, uint64_t session_number) {
  if (const auto layer = layers_.find(id); layer != layers_.end()) Erase(layer);
  keeper_->own_layer = std::move(id);
  keeper_->own_session_number = session_number;
}

void MapFollower::Refuse(const LayerId& id, std::string why) {
  if (refused_.size() < kMaxRefused) refused_.emplace(id, std::move(why));
}

std::vector<std::string> MapFollower::refused() const {
  std::vector<std::string> refused;
  for (const auto& [id, why] : refused_) refused.push_back(fmt::format("{}: {}", id.name, why));
  return refused;
}

std::vector<ReplicationMessage> MapFollower::Tick(Clock::time_point now, ByteBudget& budget) {
  std::vector<ReplicationMessage> messages;
  if (calls_ < kCalls && now >= next_call_) {
    ++calls_;
    next_call_ = now + kCallInterval;
    messages.emplace_back(MakeCall(speaker_));
  }
  for (auto entry = layers_.begin(); entry != layers_.end();) {
    const LayerFollower& copy = entry->second.copy;
    const bool is_gone = copy.IsEmpty() && Seconds(now - copy.last_spoken_for()) > kForgetAfter_s;
    if (is_gone) gossip_.SetStranger(entry->first, now);
    entry = is_gone ? Erase(entry) : std::next(entry);
  }
  for (auto& [id, followed] : layers_) {
    ShareTiles(followed.copy);
    LayerFollower::Pulls pulls = followed.copy.Tick(now);
    for (layer_pull_t& pull : pulls.nodes) {
      pull.speaker = static_cast<int64_t>(speaker_);
      messages.emplace_back(std::move(pull));
    }
    if (pulls.scans) {
      pulls.scans->speaker = static_cast<int64_t>(speaker_);
      messages.emplace_back(*std::move(pulls.scans));
    }
    if (!followed.proxy) continue;
    // What a layer of the same name has replaced can be forgotten.
    const bool may_begin = keeper_ || !HasDuplicateName(id);
    for (ReplicationMessage& message : followed.proxy->Tick(now, budget, may_begin)) {
      messages.push_back(std::move(message));
    }
  }
  if (!options_.takes_settings) return messages;
  for (settings_t& settings : gossip_.Tick(now)) messages.emplace_back(std::move(settings));
  return messages;
}

bool MapFollower::HasPulls() const {
  return std::any_of(layers_.begin(), layers_.end(), [](const auto& followed) {
    return followed.second.proxy && followed.second.proxy->HasPulls();
  });
}

Clock::time_point MapFollower::NextTick(Clock::time_point now) const {
  Clock::time_point next = options_.takes_settings ? gossip_.NextTick() : now + milliseconds(500);
  if (calls_ < kCalls) next = std::min(next, next_call_);
  for (const auto& [id, followed] : layers_) {
    next = std::min(next, followed.copy.NextTick(now));
    if (followed.proxy) next = std::min(next, followed.proxy->NextTick(now));
  }
  return next;
}

LayerSet MapFollower::Layers() {
  LayerSet set;
  if (map_options_) set.options = *map_options_;
  for (auto& [id, followed] : layers_) {
    LayerSnapshot layer = followed.copy.Snapshot();
    if (layer.session == SessionId{}) continue;
    set.layers.push_back(followed.coarser ? followed.coarser->Update(layer) : std::move(layer));
  }
  set.settings = settings();
  return set;
}

LayerSet MapFollower::SyncedLayers() const {
  LayerSet set;
  if (map_options_) set.options = *map_options_;
  for (const auto& [id, followed] : layers_) {
    if (!followed.copy.synced()) continue;
    set.layers.push_back(
        MakesLevels()
            ? CoarserCopy(options_.level_of_detail, BoxFor(id)).Update(*followed.copy.synced())
            : *followed.copy.synced());
  }
  set.settings = settings();
  return set;
}

std::vector<FollowedLayer> MapFollower::FollowedLayers(Clock::time_point now) const {
  std::vector<FollowedLayer> layers;
  for (const auto& [id, followed] : layers_) {
    const LayerFollower& copy = followed.copy;
    const auto match = copy.last_match();
    const double since_match_s =
        match ? Seconds(now - *match) : std::numeric_limits<double>::infinity();
    layers.push_back({id, copy.session(), copy.revision(), copy.num_tiles(), copy.hash(),
                      copy.matches_digest(), copy.caught_up() && since_match_s < kMaxSilence_s,
                      1000 * (since_match_s + copy.lag_s()),
                      copy.OwnerWasHeard() ? Seconds(now - copy.last_heard()) : -1,
                      copy.OwnerIsSilent(now), copy.counts()});
  }
  for (const auto& [id, announced] : announced_) {
    // Who was refused was heard.
    if (layers_.contains(id) || told_.contains(id) || refused_.contains(id)) continue;
    if (settings().Of(id).IsRemoved(announced.session)) continue;
    if (Seconds(now - announced.when) > kMaxSilence_s) continue;
    FollowedLayer& layer = layers.emplace_back();
    layer.id = id;
    layer.session = announced.session;
    layer.staleness_ms = std::numeric_limits<double>::infinity();
  }
  return layers;
}

bool MapFollower::IsCaughtUp(Clock::time_point now) const {
  const std::vector<FollowedLayer> layers = FollowedLayers(now);
  return calls_ == kCalls && !layers.empty() &&
         std::all_of(layers.begin(), layers.end(), [](const FollowedLayer& layer) {
           return layer.caught_up && layer.matches_digest;
         });
}

size_t MapFollower::NumTiles() const {
  size_t tiles = 0;
  for (const auto& [id, followed] : layers_) tiles += followed.copy.num_tiles();
  return tiles;
}

}  // namespace splinemap
