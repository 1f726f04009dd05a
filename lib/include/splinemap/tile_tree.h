#pragma once

#include "splinemap/key_tree.h"

namespace splinemap {

// The tiles of a layer or a map.
using TileTree = KeyTree<Tile>;
using TileTreeEditor = KeyTreeEditor<Tile>;

}  // namespace splinemap
