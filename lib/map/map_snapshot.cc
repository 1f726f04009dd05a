#include <algorithm>
#include <array>
#include <cstring>

#include "lib/map/map.h"
#include "lib/spline/patch_kernel.h"

namespace splinemap {
namespace {

constexpr Tile kUntouched;

// The 4 x 4 control points around a point, row-major.
struct Patch {
  ControlPoint control_points[16];
};

// Where a point lies among the knots.
struct Place {
  int32_t i;  // of the first control point of the patch
  int32_t j;
  double t_x;
  double t_y;
  bool is_on_map;  // else the rest says nothing
};

inline void Locate(double x_m, double y_m, double knot_interval_m, Place& place) {
  const auto x = LocateKnot(x_m, knot_interval_m);
  const auto y = LocateKnot(y_m, knot_interval_m);
  place.is_on_map = x && y;
  place.i = x ? x->index - 1 : 0;
  place.j = y ? y->index - 1 : 0;
  place.t_x = x ? x->t : 0;
  place.t_y = y ? y->t : 0;
}

// Remembers the tile found last; absent ones are kUntouched.
class TileFinder {
 public:
  explicit TileFinder(const TileTree& tiles) : tiles_(tiles) {}

  const Tile& Find(TileKey key) {
    if (tile_ == nullptr || key != key_) {
      const TileTree::Entry* entry = tiles_.Find(key);
      tile_ = entry == nullptr ? &kUntouched : entry->tile.get();
      key_ = key;
    }
    return *tile_;
  }

 private:
  const TileTree& tiles_;
  TileKey key_;
  const Tile* tile_ = nullptr;
};

bool IsInOneTile(const Place& place) {
  constexpr int kLast = Tile::kSide - 4;
  return (place.i & (Tile::kSide - 1)) <= kLast && (place.j & (Tile::kSide - 1)) <= kLast;
}

void LoadFromOneTile(const ControlPoint* first, Patch& patch) {
  for (int row = 0; row < 4; ++row) {
    std::memcpy(patch.control_points + 4 * row, first + Tile::kSide * row,
                4 * sizeof(ControlPoint));
  }
}

void LoadFromSeveralTiles(const Place& place, TileFinder& finder, Patch& patch) {
  const TileKey low = TileOf(place.i, place.j);
  const TileKey high = TileOf(place.i + 3, place.j + 3);
  const Tile* tiles[2][2] = {{&finder.Find(low), &finder.Find({high.tx, low.ty})},
                             {&finder.Find({low.tx, high.ty}), &finder.Find(high)}};
  for (int row = 0; row < 4; ++row) {
    for (int column = 0; column < 4; ++column) {
      const int32_t i = place.i + column;
      const int32_t j = place.j + row;
      const TileKey key = TileOf(i, j);
      const Tile* tile = tiles[key.ty != low.ty][key.tx != low.tx];
      patch.control_points[4 * row + column] = tile->control_points[IndexInTile(i, j)];
    }
  }
}

// For functions that are compiled for several kinds of instructions, which have to inline it.
__attribute__((always_inline)) inline void EvaluateAt(const Place& place, const Patch& patch,
                                                      double knot_interval_m,
                                                      SurfaceSample& sample) {
  if (!place.is_on_map) {
    sample = {};
    return;
  }
  typedef ControlPoint Units __attribute__((vector_size(8)));
  typedef int32_t Integers __attribute__((vector_size(16)));
  PatchRow rows[4];
  for (int row = 0; row < 4; ++row) {
    Units units;
    std::memcpy(&units, patch.control_points + 4 * row, sizeof(units));
    const Integers integers = __builtin_convertvector(units, Integers);
    rows[row] = __builtin_convertvector(integers, PatchRow) * (1.0 / kUnitsPerLogOdds);
  }
  EvaluateRows(rows, place.t_x, place.t_y, knot_interval_m, sample);
  const int nearest = (place.t_y < 0.5 ? 4 : 8) + (place.t_x < 0.5 ? 1 : 2);
  sample.known = patch.control_points[nearest] != 0;
}

// A few points at a time, which fit into the fastest cache.
struct Block {
  static constexpr size_t kSize = 64;
  size_t count = 0;
  std::array<Place, kSize> places;
  std::array<Patch, kSize> patches;
};

void EvaluatePlain(const Block& block, double knot_interval_m, SurfaceSample* samples) {
  for (size_t n = 0; n < block.count; ++n) {
    EvaluateAt(block.places[n], block.patches[n], knot_interval_m, samples[n]);
  }
}

#ifdef __x86_64__
__attribute__((target("avx2"))) void EvaluateAvx2(const Block& block, double knot_interval_m,
                                                  SurfaceSample* samples) {
  for (size_t n = 0; n < block.count; ++n) {
    EvaluateAt(block.places[n], block.patches[n], knot_interval_m, samples[n]);
  }
}
#endif

// By the fastest instructions that there are.
void EvaluateBlock(const Block& block, double knot_interval_m, SurfaceSample* samples) {
#ifdef __x86_64__
  static const bool has_avx2 = __builtin_cpu_supports("avx2");
  if (has_avx2) return EvaluateAvx2(block, knot_interval_m, samples);
#endif
  EvaluatePlain(block, knot_interval_m, samples);
}

}  // namespace

SurfaceSample MapSnapshot::Evaluate(double x_m, double y_m) const {
  const Eigen::Vector2d point_m(x_m, y_m);
  SurfaceSample sample;
  EvaluateMany({&point_m, 1}, {&sample, 1});
  return sample;
}

// Each step runs over a block of points before the next begins: a processor waits for many points
// of a large map at once if what it does for each of them is little.
void MapSnapshot::EvaluateMany(absl::Span<const Eigen::Vector2d> points_m,
                               absl::Span<SurfaceSample> samples) const {
  Block block;
  std::array<const ControlPoint*, Block::kSize> firsts;
  TileFinder finder(merged);
  for (size_t begin = 0; begin < points_m.size(); begin += Block::kSize) {
    block.count = std::min(Block::kSize, points_m.size() - begin);
    for (size_t n = 0; n < block.count; ++n) {
      const Eigen::Vector2d& point_m = points_m[begin + n];
      Locate(point_m.x(), point_m.y(), options.knot_interval_m, block.places[n]);
    }
    for (size_t n = 0; n < block.count; ++n) {
      const Place& place = block.places[n];
      const Tile& tile = finder.Find(TileOf(place.i, place.j));
      firsts[n] = IsInOneTile(place) ? &tile.control_points[IndexInTile(place.i, place.j)]
                                     : kUntouched.control_points.data();
    }
    for (size_t n = 0; n < block.count; ++n) LoadFromOneTile(firsts[n], block.patches[n]);
    for (size_t n = 0; n < block.count; ++n) {
      const Place& place = block.places[n];
      if (!IsInOneTile(place)) LoadFromSeveralTiles(place, finder, block.patches[n]);
    }
    EvaluateBlock(block, options.knot_interval_m, &samples[begin]);
  }
}

}  // namespace splinemap
