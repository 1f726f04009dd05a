#include "lib/map/map_changes.h"

namespace splinemap {

TileBox ChangedTiles(const MapSnapshot& before, const MapSnapshot& after) {
  TileBox box;
  const auto add = [&](TileKey key, const TileTree::Entry&) { box.Add(key); };
  if (before.merged.line() == after.merged.line()) {
    after.merged.ForEachChanged(before.merged.epoch(), add);
    return box;
  }
  before.merged.ForEach(add);
  after.merged.ForEach(add);
  return box;
}

}  // namespace splinemap
