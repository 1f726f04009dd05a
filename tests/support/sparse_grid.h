#pragma once

#include <array>
#include <cstdint>
#include <memory>

#include "absl/container/flat_hash_map.h"
#include "splinemap/tile.h"

namespace splinemap {

// A double for each pair of integers, 0 where nothing was written; kept in squares like tiles.
// Thread-compatible.
class SparseGrid {
 public:
  double& At(int32_t i, int32_t j);
  double Get(int32_t i, int32_t j) const;
  size_t tiles() const { return squares_.size(); }

 private:
  using Square = std::array<double, Tile::kSize>;

  absl::flat_hash_map<TileKey, std::unique_ptr<Square>> squares_;
  TileKey last_key_;  // of *last_, the square that At() used last
  Square* last_ = nullptr;
};

}  // namespace splinemap
