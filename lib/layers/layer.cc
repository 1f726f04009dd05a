#include "splinemap/layer.h"

#include <algorithm>
#include <utility>

namespace splinemap {

void Layer::RestoreTile(TileKey key, std::shared_ptr<const StoredTile> tile, uint64_t revision) {
  if (tiles().Find(key) != nullptr && tiles().RevisionOf(key) >= revision) return;
  tiles_.Put(key, std::move(tile), revision);
  RestoreRevision(revision);
}

void Layer::RestoreRevision(uint64_t revision) { revision_ = std::max(revision_, revision); }

}  // namespace splinemap
