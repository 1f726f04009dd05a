#pragma once

#include <cstddef>
#include <list>
#include <memory>
#include <string>

#include "absl/container/flat_hash_map.h"
#include "splinemap/tile.h"

namespace splinemap {

// Tiles as the page reads them, compressed once for all browsers. Thread-compatible.
class TileBodies {
 public:
  // 2 KiB and some hundred bytes each.
  static constexpr size_t kMaxTiles = 16'384;

  // Deflate without a header of the control points, row-major, int16, little-endian. Valid until
  // the next call.
  const std::string& Of(const std::shared_ptr<const StoredTile>& tile);

 private:
  struct Body {
    std::shared_ptr<const StoredTile> tile;  // keeps its address from being used again
    std::string bytes;
  };

  std::list<Body> newest_first_;
  absl::flat_hash_map<const StoredTile*, std::list<Body>::iterator> by_tile_;
};

}  // namespace splinemap
