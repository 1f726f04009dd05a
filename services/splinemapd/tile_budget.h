#pragma once

#include <algorithm>
#include <cstddef>
#include <memory>

#include "lib/tiles/tile_memory.h"
#include "splinemap/layer_set.h"
#include "splinemap/scan_archive.h"

namespace splinemap {

// Shares the memory of a daemon's maps: what the list of all tiles and the scans take, tiles
// themselves cannot have. Thread-compatible.
class TileBudget {
 public:
  // Of each tile, in memory or not: its place in trees, and its checksum in those of hashes
  // (measured, tests/bench/memory).
  static constexpr size_t kBytesOfListed = 300;

  explicit TileBudget(size_t max_bytes)
      : max_bytes_(max_bytes),
        memory_(std::make_shared<TileMemory>(max_bytes / TileMemory::kBytesPerTile)) {}

  const std::shared_ptr<TileMemory>& memory() const { return memory_; }

  // Leaves tiles the rest, an eighth at least. Returns what would be enough for that, in bytes.
  size_t Share(const LayerSet& set) {
    size_t taken = 0;
    for (const LayerSnapshot& layer : set.layers) {
      taken += kBytesOfListed * layer.tiles.size();
      if (layer.archive) taken += layer.archive->bytes();
    }
    const size_t least = max_bytes_ / 8;
    const size_t rest = std::max(max_bytes_ - std::min(taken, max_bytes_), least);
    memory_->SetMaxTiles(rest / TileMemory::kBytesPerTile);
    return taken + least;
  }
  size_t max_bytes() const { return max_bytes_; }

 private:
  const size_t max_bytes_;
  const std::shared_ptr<TileMemory> memory_;
};

}  // namespace splinemap
