#include "lib/tiles/coarser_tile.h"

#include <algorithm>
#include <array>

namespace splinemap {
namespace {

constexpr int kReach = 2;  // of the low-pass, to each side
constexpr int kFineSide = 2 * Tile::kSide + 2 * kReach;

using FineRow = std::array<ControlPoint, kFineSide>;

// fine[y][x] = finer[64 tx - 2 + x, 64 ty - 2 + y]
void LoadFine(const TileTree& finer, TileKey key, std::array<FineRow, kFineSide>& fine) {
  const int32_t x0 = 2 * Tile::kSide * key.tx - kReach;
  const int32_t y0 = 2 * Tile::kSide * key.ty - kReach;
  for (int32_t ty = y0 >> 5; ty <= (y0 + kFineSide - 1) >> 5; ++ty) {
    for (int32_t tx = x0 >> 5; tx <= (x0 + kFineSide - 1) >> 5; ++tx) {
      const std::shared_ptr<const Tile> tile = FindTile(finer, {tx, ty});
      const int begin_x = std::max(32 * tx, x0);
      const int end_x = std::min(32 * tx + 32, x0 + kFineSide);
      const int end_y = std::min(32 * ty + 32, y0 + kFineSide);
      for (int y = std::max(32 * ty, y0); y < end_y; ++y) {
        ControlPoint* const to = &fine[y - y0][begin_x - x0];
        if (tile == nullptr) {
          std::fill_n(to, end_x - begin_x, ControlPoint{0});
        } else {
          std::copy_n(&tile->control_points[IndexInTile(begin_x, y)], end_x - begin_x, to);
        }
      }
    }
  }
}

// Of five neighbours from `v` on, `stride` apart.
template <typename T>
int32_t LowPass(const T* v, int stride) {
  return v[0] + 4 * v[stride] + 6 * v[2 * stride] + 4 * v[3 * stride] + v[4 * stride];
}

Tile LowPassed(const std::array<FineRow, kFineSide>& fine) {
  // The sums of rows, and whether one of the five was touched.
  std::array<std::array<int32_t, Tile::kSide>, kFineSide> sums;
  std::array<std::array<bool, Tile::kSide>, kFineSide> touched;
  for (int y = 0; y < kFineSide; ++y) {
    for (int i = 0; i < Tile::kSide; ++i) {
      const ControlPoint* v = &fine[y][2 * i];
      sums[y][i] = LowPass(v, 1);
      touched[y][i] = (v[0] | v[1] | v[2] | v[3] | v[4]) != 0;
    }
  }
  Tile tile;
  for (int j = 0; j < Tile::kSide; ++j) {
    for (int i = 0; i < Tile::kSide; ++i) {
      const int32_t sum = LowPass(&sums[2 * j][i], Tile::kSide);
      bool is_touched = false;
      for (int l = 0; l < 5; ++l) is_touched |= touched[2 * j + l][i];
      const int32_t mean = (sum + 128) >> 8;
      if (is_touched) {
        tile.control_points[IndexInTile(i, j)] = static_cast<ControlPoint>(mean == 0 ? 1 : mean);
      }
    }
  }
  return tile;
}

Tile Bound(const std::array<FineRow, kFineSide>& fine, Statistic statistic) {
  Tile tile;
  for (int j = 0; j < Tile::kSide; ++j) {
    const FineRow& row = fine[2 * j + kReach];
    const FineRow& next = fine[2 * j + kReach + 1];
    for (int i = 0; i < Tile::kSide; ++i) {
      const int x = 2 * i + kReach;
      const auto four = {row[x], row[x + 1], next[x], next[x + 1]};
      const auto [least, greatest] = std::minmax(four);
      if (least == 0 && greatest == 0) continue;
      ControlPoint& bound = tile.control_points[IndexInTile(i, j)];
      bound = statistic == Statistic::kMin ? least : greatest;
      if (bound == 0) bound = statistic == Statistic::kMin ? -1 : 1;
    }
  }
  return tile;
}

}  // namespace

Tile CoarserTile(const TileTree& finer, TileKey key, Statistic statistic) {
  std::array<FineRow, kFineSide> fine;
  LoadFine(finer, key, fine);
  return statistic == Statistic::kMean ? LowPassed(fine) : Bound(fine, statistic);
}

}  // namespace splinemap
