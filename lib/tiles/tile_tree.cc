#include "splinemap/tile_tree.h"

#include "lib/tiles/key_tree_impl.h"

namespace splinemap {

template class KeyTree<Tile>;
template class KeyTreeEditor<Tile>;

}  // namespace splinemap
