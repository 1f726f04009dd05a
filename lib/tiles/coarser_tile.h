#pragma once

#include "splinemap/level_of_detail.h"
#include "splinemap/tile.h"
#include "splinemap/tile_tree.h"

namespace splinemap {

// Tile `key` of the level above that of `finer`; all zeros where there is nothing below it.
//
// kMean: coarse[i, j] = floor((sum_kl w[k] w[l] finer[2i + k, 2j + l] + 128) / 256) with
// w = (1, 4, 6, 4, 1), k and l from -2 to 2. Those are the weights that a cubic B-spline has in
// terms of those of half its width, as a low-pass. Where a finer one was touched and the sum is 0:
// +1.
//
// kMin, kMax: the least and the greatest of finer[2i + {0, 1}, 2j + {0, 1}], where untouched ones
// count as 0, so that sums of layers keep within sums of bounds. Where one was touched and the
// result is 0: -1 and +1.
Tile CoarserTile(const TileTree& finer, TileKey key, Statistic statistic);

}  // namespace splinemap
