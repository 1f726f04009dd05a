#include "splinemap/tile_tree.h"

#include "lib/tiles/key_tree_impl.h"

namespace splinemap {

template class KeyTree<StoredTile>;
template class KeyTreeEditor<StoredTile>;

std::shared_ptr<const Tile> FindTile(const TileTree& tiles, TileKey key) {
  const StoredTile* tile = tiles.Find(key);
  return tile == nullptr ? nullptr : tile->Get();
}

}  // namespace splinemap
