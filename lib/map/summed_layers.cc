#include "lib/map/summed_layers.h"

#include <algorithm>
#include <deque>

#include "absl/container/flat_hash_set.h"
#include "lib/tiles/sum_tiles.h"

namespace splinemap {

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
  std::vector<const Tile*>& tiles = tiles_;
  std::vector<const Tile*>& low = low_weight_tiles_;
  std::deque<Tile> placed;
  tiles.clear();
  low.clear();
  for (const Summand& summand : summands) {
    const TileTree& layer = summand.layer->tiles;
    const Tile* tile = summand.placement.IsIdentity()
                           ? layer.Find(key)
                           : PlaceTile(layer, key, summand.placement, placed.emplace_back());
    if (tile != nullptr) (summand.low_weight ? low : tiles).push_back(tile);
  }
  Tile low_sum;
  if (!low.empty()) {
    const ControlLimits within{static_cast<ControlPoint>(limits.min * 4 / 5),
                               static_cast<ControlPoint>(limits.max * 4 / 5)};
    low_sum = SumTiles(low, within);
    tiles.push_back(&low_sum);
  }
  // Tiles that one of a layer has a part in may have nothing of it.
  if (!tiles.empty()) sum_.Edit(key, 0) = SumTiles(tiles, limits);
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
