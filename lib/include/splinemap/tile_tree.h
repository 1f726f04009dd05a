#pragma once

#include <memory>

#include "splinemap/key_tree.h"
#include "splinemap/stored_tile.h"
#include "splinemap/tile.h"

namespace splinemap {

// The tiles of a layer or a map. Not all of them need be in memory.
using TileTree = KeyTree<StoredTile>;
using TileTreeEditor = KeyTreeEditor<StoredTile>;

// The content of a tile, null where it is absent.
std::shared_ptr<const Tile> FindTile(const TileTree& tiles, TileKey key);

}  // namespace splinemap
