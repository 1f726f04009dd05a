#include "lib/map/map_changes.h"

namespace splinemap {

namespace {

// Of the whole map, where there is one.
std::optional<Region> RegionOfAll(const MapView& map) {
  TileBox box;
  map.tiles.ForEach([&](TileKey key, const TileTree::Entry&) { box.Add(key); });
  if (box.IsEmpty()) return std::nullopt;
  return RegionOf(box, map.options.knot_interval_m);
}

}  // namespace

TileBox ChangedTiles(const MapView& before, const MapView& after) {
  TileBox box;
  const auto add = [&](TileKey key, const TileTree::Entry&) { box.Add(key); };
  if (before.tiles.lineage() == after.tiles.lineage()) {
    after.tiles.ForEachChanged(before.tiles.version(), add);
    return box;
  }
  before.tiles.ForEach(add);
  after.tiles.ForEach(add);
  return box;
}

std::optional<Region> ChangedRegion(const MapView& before, const MapView& after) {
  if (before.options == after.options) {
    const TileBox changed = ChangedTiles(before, after);
    if (changed.IsEmpty()) return std::nullopt;
    return RegionOf(changed, after.options.knot_interval_m);
  }
  const std::optional<Region> gone = RegionOfAll(before);
  const std::optional<Region> come = RegionOfAll(after);
  if (!gone || !come) return gone ? gone : come;
  return Region{std::min(gone->x0_m, come->x0_m), std::min(gone->y0_m, come->y0_m),
                std::max(gone->x1_m, come->x1_m), std::max(gone->y1_m, come->y1_m)};
}

}  // namespace splinemap
