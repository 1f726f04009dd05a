#include "lib/map/tile_tree.h"

#include "lib/map/key_tree_impl.h"

namespace splinemap {

template class KeyTree<Tile>;
template class KeyTreeEditor<Tile>;

}  // namespace splinemap
