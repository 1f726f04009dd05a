#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "absl/container/flat_hash_map.h"
#include "lib/map/layer.h"
#include "lib/map/tile.h"

namespace splinemap {

// Sums of the measurements of one scan by control point, in fixed point, exact and independent of
// the order. Keeps its memory from scan to scan. Thread-compatible.
//
// No overflow: one beam adds at most 7.2 log-odds to a control point (a hit 16/9 * kMaxKappaHit;
// free samples, at least kMinFreeSampleSpacingKnots apart, 4/3 * 3.5 * |kMinKappaFree|), and
// kMaxBeams of them stay within 32 bits.
class ScanScratch {
 public:
  // 64 units are one unit of a control point.
  static constexpr int kFractionBits = 6;
  static constexpr int kUnitsPerLogOdds = splinemap::kUnitsPerLogOdds << kFractionBits;

  // The sum of control point (i, j). The reference is valid until the next call.
  int32_t& At(int32_t i, int32_t j) { return SumsOf(TileOf(i, j))[IndexInTile(i, j)]; }

  // Adds all sums to the layer as one commit, each rounded once and kept within `scan_limits`, the
  // results clamped to `limits` (36), and clears the scratch. A control point whose sum rounds to 0
  // is left as it was.
  void CommitTo(Layer& layer, ControlLimits limits, ControlLimits scan_limits = {});

 private:
  struct Sums {
    TileKey key;
    std::array<int32_t, Tile::kSize> sums;
  };

  std::array<int32_t, Tile::kSize>& SumsOf(TileKey key);

  absl::flat_hash_map<TileKey, size_t> index_;  // into tiles_
  std::vector<Sums> tiles_;                     // the first index_.size() are in use
  TileKey last_key_;
  size_t last_ = 0;  // tile of last_key_, if index_ is not empty
};

}  // namespace splinemap
