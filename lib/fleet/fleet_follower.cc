#include "lib/fleet/fleet_follower.h"

#include <algorithm>
#include <limits>
#include <utility>

#include "lib/base/plain_text.h"
#include "lib/base/status.h"
#include "lib/layers/validity.h"
#include "lib/replication/map_follower.h"
#include "lib/store/settings_record.h"

namespace splinemap {
namespace {

constexpr const char* kDigestFilter = "layers.*.*.digest";
constexpr const char* kSettingsFilter = "settings.>";

bool Overlap(const TileBox& a, const TileBox& b) {
  return !a.IsEmpty() && !b.IsEmpty() && a.tx0 < b.tx1 && b.tx0 < a.tx1 && a.ty0 < b.ty1 &&
         b.ty0 < a.ty1;
}

}  // namespace

std::vector<std::string> FleetFollower::Filters() const {
  std::vector<std::string> filters = {kMapKey, kSettingsFilter};
  std::set<std::string> digests;
  for (const std::string& name : options_.names) {
    const bool is_pattern = name.find_first_of("*?[") != std::string::npos;
    if (!name.empty()) digests.insert(is_pattern ? kDigestFilter : DigestFilter(name));
  }
  if (options_.names.empty() || digests.contains(kDigestFilter)) digests = {kDigestFilter};
  filters.insert(filters.end(), digests.begin(), digests.end());
  if (options_.parts) {
    for (const int part : *options_.parts) filters.push_back(PartFilter(part));
    for (const auto& [id, layer] : layers_) {
      if (IsPlaced(id)) filters.push_back(TilesFilter(id));
    }
    return filters;
  }
  const bool is_all = options_.names.empty() && !options_.region && !options_.but;
  if (is_all) {
    filters.push_back("layers.*.*.tiles.>");
    return filters;
  }
  for (const auto& [id, layer] : layers_) {
    if (IsSelected(id)) filters.push_back(TilesFilter(id));
  }
  return filters;
}

// By its name alone.
bool FleetFollower::IsFollowed(const LayerId& id) const {
  if (options_.but && *options_.but == id.name) return false;
  return options_.names.empty() ||
         std::any_of(options_.names.begin(), options_.names.end(),
                     [&](const std::string& name) { return MatchesName(name, id.name); });
}

// By where it is, too.
bool FleetFollower::IsSelected(const LayerId& id) const {
  if (!IsFollowed(id)) return false;
  if (!options_.region) return true;
  const auto layer = layers_.find(id);
  if (layer == layers_.end() || !layer->second.digest) return false;
  const LayerDigest& digest = *layer->second.digest;
  if (IsPlaced(id)) return true;  // its box is in another frame
  return Overlap(digest.box, TilesOf(*options_.region, digest.options.knot_interval_m));
}

bool FleetFollower::IsPlaced(const LayerId& id) const {
  return settings_.Of(id).placement != FixedPose2();
}

bool FleetFollower::IsFollowed(const LayerId& id, BlockKey block) const {
  return IsFollowed(id) &&
         (!options_.parts || options_.parts->contains(PartOf(block)) || IsPlaced(id));
}

void FleetFollower::SetParts(std::set<int> parts) {
  options_.parts = std::move(parts);
  ForgetOtherParts();
}

void FleetFollower::ForgetOtherParts() {
  std::erase_if(known_, [&](const auto& known) {
    const FleetKey key = ParseFleetKey(known.first);
    return key.kind == FleetKey::Kind::kBlock && !IsFollowed(key.layer, key.block);
  });
  std::vector<LayerId> changed;
  for (auto& [id, layer] : layers_) {
    const auto is_other = [&, &of = id](const auto& block) { return !IsFollowed(of, block.first); };
    if (std::none_of(layer.blocks.begin(), layer.blocks.end(), is_other)) continue;
    std::erase_if(layer.blocks, is_other);
    TileTreeEditor rest;
    layer.tiles.tree().ForEach([&, &of = id](TileKey at, const TileTree::Entry& entry) {
      if (IsFollowed(of, BlockKey::Of(at))) rest.Put(at, entry.tile, entry.revision);
    });
    layer.tiles = std::move(rest);
    tiles_ -= layer.sum.tiles;
    layer.sum = {};
    for (const auto& [key, sum] : layer.blocks) {
      layer.sum.tiles += sum.tiles;
      layer.sum.hash += sum.hash;
    }
    tiles_ += layer.sum.tiles;
    changed.push_back(id);
  }
  for (const LayerId& id : changed) Compare(id, layers_[id]);
}

bool FleetFollower::Knows(const std::string& filter) const {
  const std::string prefix = filter.substr(0, filter.find_first_of("*>"));
  for (auto known = known_.lower_bound(prefix);
       known != known_.end() && known->first.compare(0, prefix.size(), prefix) == 0; ++known) {
    if (MatchesFilter(filter, known->first)) return true;
  }
  return false;
}

bool FleetFollower::HasRoom(const LayerId& id) const {
  if (layers_.contains(id)) return true;
  const auto begin = layers_.lower_bound({id.name, 0});
  const auto end = layers_.upper_bound({id.name, UINT64_MAX});
  return layers_.size() < kMaxLayers &&
         std::distance(begin, end) < static_cast<int64_t>(kMaxLayersOfName);
}

void FleetFollower::Handle(const FleetEntry& entry, Clock::time_point now) {
  const FleetKey key = ParseFleetKey(entry.key);
  if (key.kind == FleetKey::Kind::kOther) return;
  const auto known = known_.find(entry.key);
  if (known != known_.end() && entry.revision <= known->second.revision) return;
  Take(entry, key, now);
}

void FleetFollower::Take(const FleetEntry& entry, const FleetKey& key, Clock::time_point now) {
  using Kind = FleetKey::Kind;
  const bool is_layers = key.kind == Kind::kDigest || key.kind == Kind::kBlock;
  if (is_layers && (!IsFollowed(key.layer) || !HasRoom(key.layer))) return;
  if (key.kind == Kind::kBlock && !IsFollowed(key.layer, key.block)) return;
  const absl::Status taken = key.kind == Kind::kMap        ? TakeMap(entry)
                             : key.kind == Kind::kSettings ? TakeSettings(entry, key.layer)
                             : key.kind == Kind::kDigest   ? TakeDigest(entry, key.layer, now)
                                                           : TakeBlock(entry, key, now);
  const auto layer = is_layers ? layers_.find(key.layer) : layers_.end();
  if (entry.value.empty() || absl::IsResourceExhausted(taken)) {
    known_.erase(entry.key);
  } else if (taken.ok() || layer != layers_.end()) {
    // Also of what is damaged: it is read again when it was written again.
    known_[entry.key] = {entry.revision, entry.hash};
  }
  if (taken.ok()) return;
  ++malformed_;
  if (layer != layers_.end()) layer->second.problem = entry.key + ": " + ErrorText(taken);
}

std::vector<std::string> FleetFollower::HandleList(const std::string& filter,
                                                   const std::vector<FleetEntry>& entries,
                                                   Clock::time_point now) {
  std::set<std::string> listed;
  std::vector<std::string> wanted;
  for (const FleetEntry& entry : entries) {
    const FleetKey key = ParseFleetKey(entry.key);
    if (key.kind == FleetKey::Kind::kOther) continue;
    if (entry.hash == 0 && entry.value.empty()) continue;  // it was removed
    listed.insert(entry.key);
    const auto known = known_.find(entry.key);
    if (known != known_.end() && known->second.hash == entry.hash) {
      known->second.revision = entry.revision;  // a bucket made anew counts from the beginning
    } else if (entry.value.empty()) {
      wanted.push_back(entry.key);
    } else if (known == known_.end() || known->second.revision < entry.revision) {
      Take(entry, key, now);
    }
  }
  // Also what is not in the list, which may be older than what came beside.
  const std::string prefix = filter.substr(0, filter.find_first_of("*>"));
  for (auto known = known_.lower_bound(prefix);
       known != known_.end() && known->first.compare(0, prefix.size(), prefix) == 0; ++known) {
    const std::string& key = known->first;
    if (!listed.contains(key) && MatchesFilter(filter, key)) wanted.push_back(key);
  }
  for (const std::string& key : wanted) {
    if (const auto known = known_.find(key); known != known_.end()) known->second.revision = 0;
  }
  return wanted;
}

bool FleetFollower::Has(const std::string& key) const {
  const auto known = known_.find(key);
  return known != known_.end() && known->second.revision > 0;
}

void FleetFollower::HandleGone(const std::string& key, Clock::time_point now) {
  if (known_.contains(key)) Take({.key = key, .value = ""}, ParseFleetKey(key), now);
}

absl::Status FleetFollower::TakeMap(const FleetEntry& entry) {
  if (entry.value.empty()) return absl::OkStatus();  // its layers say the same
  SPLINEMAP_ASSIGN_OR_RETURN(const MapOptions options, DecodeMapOptions(entry.value));
  if (map_options_ == options) return absl::OkStatus();
  // What was refused may be taken now.
  if (map_options_) known_.clear();
  map_options_ = options;
  ++version_;
  return absl::OkStatus();
}

absl::Status FleetFollower::TakeSettings(const FleetEntry& entry, const LayerId& id) {
  if (entry.value.empty()) return absl::OkStatus();  // what was decided stays
  SPLINEMAP_ASSIGN_OR_RETURN(const LayerSettings settings, DecodeSettings(entry.value, id));
  const bool was_placed = IsPlaced(id);
  if (settings_.Merge(id, settings)) ++version_;
  if (was_placed && !IsPlaced(id)) {
    compared_placed_.erase(id);
    ForgetOtherParts();
  }
  return absl::OkStatus();
}

absl::Status FleetFollower::TakeDigest(const FleetEntry& entry, const LayerId& id,
                                       Clock::time_point now) {
  if (entry.value.empty()) {
    const auto layer = layers_.find(id);
    if (layer == layers_.end()) return absl::OkStatus();
    layer->second.digest.reset();
    Compare(id, layer->second);
    return absl::OkStatus();
  }
  SPLINEMAP_ASSIGN_OR_RETURN(LayerDigest digest, DecodeDigest(entry.value, id));
  if (HashOf(digest) != entry.hash) return DataLoss("it is not what its writer said");
  Followed& layer = layers_[id];
  layer.digest = std::move(digest);
  layer.changed = now;
  layer.problem.clear();
  Compare(id, layer);
  return absl::OkStatus();
}

absl::Status FleetFollower::TakeBlock(const FleetEntry& entry, const FleetKey& key,
                                      Clock::time_point now) {
  // Those of other limits are not in the sum, and may be decoded.
  constexpr ControlLimits kAll{std::numeric_limits<ControlPoint>::min(),
                               std::numeric_limits<ControlPoint>::max()};
  const ControlLimits limits = map_options_ ? map_options_->limits : kAll;
  SPLINEMAP_ASSIGN_OR_RETURN(const LayerBlock block,
                             DecodeBlock(entry.value, key.block, &key.layer, limits));
  if (HashOf(block, key.block) != entry.hash) return DataLoss("it is not what its writer said");
  const auto found = layers_.find(key.layer);
  if (block.IsEmpty() && found == layers_.end()) return absl::OkStatus();
  uint64_t before = 0;
  if (found != layers_.end()) {
    const auto known = found->second.blocks.find(key.block);
    if (known != found->second.blocks.end()) before = known->second.tiles;
  }
  if (tiles_ - before + block.SumOf(key.block).tiles > kMaxTiles) {
    return absl::ResourceExhaustedError("there is no room for more tiles");
  }
  Followed& layer = layers_[key.layer];
  ReplaceBlock(layer, key.block, block);
  layer.changed = now;
  layer.has_stalled = false;
  Compare(key.layer, layer);
  return absl::OkStatus();
}

void FleetFollower::ReplaceBlock(Followed& layer, BlockKey key, const LayerBlock& block) {
  const LayerBlock before = BlockOf(layer.tiles.tree(), key);
  for (int child = 0; child < static_cast<int>(block.tiles.size()); ++child) {
    const LayerBlock::Entry& entry = block.tiles[child];
    const TileKey at = key.Tile(child);
    if (!entry.tile) {
      if (before.tiles[child].tile) layer.gone.insert(at);
      continue;
    }
    layer.gone.erase(at);
    if (!before.tiles[child].tile ||
        before.tiles[child].tile->Checksum(at) != entry.tile->Checksum(at)) {
      layer.tiles.Put(at, entry.tile, entry.revision);
    }
  }
  LayerBlock::Sum& sum = layer.blocks[key];
  layer.sum.tiles -= sum.tiles;
  layer.sum.hash -= sum.hash;
  tiles_ -= sum.tiles;
  sum = block.SumOf(key);
  layer.sum.tiles += sum.tiles;
  layer.sum.hash += sum.hash;
  tiles_ += sum.tiles;
  if (sum.tiles == 0) layer.blocks.erase(key);
}

void FleetFollower::Compare(const LayerId& id, Followed& layer) {
  ++version_;
  ++layer.version;
  const auto& digest = layer.digest;
  layer.matches = digest && !digest->is_arriving && digest->tiles == layer.sum.tiles &&
                  digest->hash == layer.sum.hash;
  if (layer.matches) layer.whole = SnapshotOf(id, layer);
  if (!digest && layer.sum.tiles == 0) layers_.erase(id);
}

LayerSnapshot FleetFollower::SnapshotOf(const LayerId& id, Followed& layer) {
  if (!layer.gone.empty()) {
    TileTreeEditor rest;
    layer.tiles.tree().ForEach([&](TileKey at, const TileTree::Entry& entry) {
      if (!layer.gone.contains(at)) rest.Put(at, entry.tile, entry.revision);
    });
    layer.tiles = std::move(rest);
    layer.gone.clear();
  }
  return {id, layer.digest->session, layer.digest->revision, layer.tiles.Freeze()};
}

bool FleetFollower::UsesOtherOptions(const Followed& layer) const {
  return layer.digest && map_options_ && layer.digest->options != *map_options_;
}

LayerSet FleetFollower::Layers() {
  LayerSet set;
  if (!map_options_) return set;
  set.options = *map_options_;
  set.settings = settings_;
  for (auto& [id, layer] : layers_) {
    if (!layer.digest || UsesOtherOptions(layer) || !IsSelected(id)) continue;
    if (settings_.Of(id).IsRemoved(layer.digest->session)) continue;
    if (options_.parts && IsPlaced(id) && !compared_placed_.contains(id)) continue;
    set.layers.push_back(SnapshotOf(id, layer));
  }
  return set;
}

const LayerSnapshot* FleetFollower::Whole(const LayerId& id) const {
  const auto layer = layers_.find(id);
  return layer == layers_.end() || !layer->second.whole ? nullptr : &*layer->second.whole;
}

std::vector<FollowedLayer> FleetFollower::FollowedLayers(Clock::time_point now) const {
  std::vector<FollowedLayer> followed;
  for (const auto& [id, layer] : layers_) {
    if (!layer.digest || UsesOtherOptions(layer) || !IsSelected(id) ||
        settings_.Of(id).IsRemoved(layer.digest->session)) {
      continue;
    }
    FollowedLayer row;
    row.id = id;
    row.session = layer.digest->session;
    row.revision = layer.digest->revision;
    row.tiles = layer.sum.tiles;
    row.hash = layer.sum.hash;
    row.matches_digest = layer.matches || options_.parts;
    row.caught_up = row.matches_digest;
    row.heard_s_ago = std::chrono::duration<double>(now - layer.changed).count();
    row.staleness_ms = row.matches_digest ? 0 : row.heard_s_ago * 1000;
    followed.push_back(row);
  }
  return followed;
}

bool FleetFollower::IsWhole() const {
  if (options_.parts) return true;
  return std::all_of(layers_.begin(), layers_.end(), [&](const auto& layer) {
    return layer.second.matches || !IsSelected(layer.first) || UsesOtherOptions(layer.second);
  });
}

void FleetFollower::NoteCompared(const std::string& filter) {
  if (!options_.parts) return;
  for (const auto& [id, layer] : layers_) {
    if (IsPlaced(id) && TilesFilter(id) == filter && compared_placed_.insert(id).second) ++version_;
  }
}

std::vector<std::string> FleetFollower::DrainStalled(Clock::time_point now) {
  constexpr std::chrono::seconds kPatience(5);
  std::vector<std::string> stalled;
  if (options_.parts) return stalled;
  for (auto& [id, layer] : layers_) {
    if (layer.matches || layer.has_stalled || now - layer.changed < kPatience || !IsSelected(id) ||
        UsesOtherOptions(layer)) {
      continue;
    }
    layer.has_stalled = true;
    stalled.push_back(TilesFilter(id));
  }
  return stalled;
}

std::vector<LayerId> FleetFollower::ForgottenSettings() const {
  std::vector<LayerId> forgotten;
  for (const auto& [id, settings] : settings_.records()) {
    SettingsTable alone;
    alone.Merge(id, settings);
    const auto known = known_.find(SettingsKey(id));
    if (known == known_.end() || known->second.hash != alone.hash()) forgotten.push_back(id);
  }
  return forgotten;
}

std::vector<std::string> FleetFollower::Refused() const {
  std::vector<std::string> refused;
  for (const auto& [id, layer] : layers_) {
    if (UsesOtherOptions(layer)) {
      refused.push_back(fmt::format("{}: it has {}; the fleet's map has {}", PlainText(id.name),
                                    TextOf(layer.digest->options), TextOf(*map_options_)));
    } else if (!layer.problem.empty()) {
      refused.push_back(PlainText(layer.problem));
    }
  }
  return refused;
}

}  // namespace splinemap
