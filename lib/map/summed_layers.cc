#include "lib/map/summed_layers.h"

#include <algorithm>
#include <deque>

#include "absl/container/flat_hash_set.h"
#include "lib/tiles/sum_tiles.h"

namespace splinemap {
namespace {

// A tile of the sum, made when somebody asks for it.
class TileSum : public TileSource {
 public:
  // The tiles of a layer that have a part in it.
  struct Part {
    bool low_weight;
    KnotPlacement placement;
    std::vector<std::pair<TileKey, std::shared_ptr<const StoredTile>>> tiles;
  };

  TileSum(TileKey key, std::vector<Part> parts, ControlLimits limits,
          std::shared_ptr<TileMemory> memory)
      : TileSource(std::move(memory)), key_(key), parts_(std::move(parts)), limits_(limits) {}

  std::shared_ptr<const Tile> Load(int64_t /*number*/, uint64_t /*checksum*/) override {
    std::deque<std::shared_ptr<const Tile>> held;
    std::vector<const Tile*> tiles;
    std::vector<const Tile*> low_weight_tiles;
    for (const Part& part : parts_) {
      held.push_back(ContentOf(part));
      (part.low_weight ? low_weight_tiles : tiles).push_back(held.back().get());
    }
    Tile low_sum;
    if (!low_weight_tiles.empty()) {
      const ControlLimits within{static_cast<ControlPoint>(limits_.min * 4 / 5),
                                 static_cast<ControlPoint>(limits_.max * 4 / 5)};
      low_sum = SumTiles(low_weight_tiles, within);
      tiles.push_back(&low_sum);
    }
    return std::make_shared<const Tile>(SumTiles(tiles, limits_));
  }

 private:
  std::shared_ptr<const Tile> ContentOf(const Part& part) const {
    if (part.placement.IsIdentity()) return part.tiles.front().second->Get();
    TileTreeEditor layer;
    for (const auto& [key, tile] : part.tiles) layer.Put(key, tile, 0);
    auto placed = std::make_shared<Tile>();
    PlaceTile(layer.tree(), key_, part.placement, *placed);
    return placed;
  }

  const TileKey key_;
  const std::vector<Part> parts_;
  const ControlLimits limits_;
};

}  // namespace

std::shared_ptr<const MapView> SummedLayers::Update(const LayerSet& set) {
  auto view = std::make_shared<MapView>();
  view->options = set.options;
  for (const LayerSnapshot& layer : set.layers) view->revision += layer.revision;
  for (const auto& [id, setting] : set.settings.records()) view->revision += setting.counter;
  view->tiles = Sum(set);
  return view;
}

TileTree SummedLayers::Sum(const LayerSet& set) {
  std::vector<Summand> summands;
  for (const LayerSnapshot& layer : set.layers) {
    const LayerSettings& setting = set.settings.Of(layer.id);
    if (!setting.IsSummed()) continue;
    summands.push_back(
        {&layer, setting.low_weight,
         KnotPlacement(setting.placement, set.options.knot_interval_m, level_of_detail_)});
  }
  if (!Continues(summands)) {
    sum_ = TileTreeEditor();
    seen_.clear();
  }
  // One layer is its own sum: its control points are within the limits already.
  if (summands.size() == 1 && !summands[0].low_weight && summands[0].placement.IsIdentity()) {
    return summands[0].layer->tiles;
  }
  absl::flat_hash_set<TileKey> changed;
  for (const Summand& summand : summands) {
    const LayerSnapshot* layer = summand.layer;
    Seen& seen = seen_
                     .try_emplace(layer->id, Seen{layer->session, summand.low_weight,
                                                  summand.placement, layer->tiles.lineage()})
                     .first->second;
    layer->tiles.ForEachChanged(seen.up_to, [&](TileKey key, const TileTree::Entry&) {
      for (const TileKey moved : KeysOfPlaced(key, summand.placement)) changed.insert(moved);
    });
    seen.up_to = layer->tiles.version();
  }
  for (const TileKey& key : changed) SumTile(key, summands, set.options.limits);
  return sum_.Freeze();
}

void SummedLayers::SumTile(TileKey key, const std::vector<Summand>& summands,
                           ControlLimits limits) {
  std::vector<TileSum::Part> parts;
  for (const Summand& summand : summands) {
    const TileTree& layer = summand.layer->tiles;
    TileSum::Part part{summand.low_weight, summand.placement, {}};
    if (summand.placement.IsIdentity()) {
      if (auto tile = layer.Share(key)) part.tiles.emplace_back(key, std::move(tile));
    } else {
      for (const TileKey under : KeysUnder(key, summand.placement)) {
        if (auto tile = layer.Share(under)) part.tiles.emplace_back(under, std::move(tile));
      }
    }
    if (!part.tiles.empty()) parts.push_back(std::move(part));
  }
  if (parts.empty()) return;
  // One tile is its own sum, as one layer is.
  if (parts.size() == 1 && !parts[0].low_weight && parts[0].placement.IsIdentity()) {
    sum_.Put(key, parts[0].tiles.front().second, 0);
    return;
  }
  auto sum = std::make_shared<TileSum>(key, std::move(parts), limits, memory_);
  sum_.Put(key, std::make_shared<const StoredTile>(std::move(sum), 0), 0);
}

bool SummedLayers::Continues(const std::vector<Summand>& summands) const {
  size_t known = 0;
  for (const Summand& summand : summands) {
    const LayerSnapshot* layer = summand.layer;
    const auto seen = seen_.find(layer->id);
    if (seen == seen_.end()) continue;
    const Seen& before = seen->second;
    if (before.session != layer->session || before.low_weight != summand.low_weight ||
        before.placement != summand.placement || before.lineage != layer->tiles.lineage()) {
      return false;
    }
    ++known;
  }
  return known == seen_.size();
}

std::shared_ptr<const MapView> ViewOf(const LayerSet& set) { return SummedLayers().Update(set); }

}  // namespace splinemap
