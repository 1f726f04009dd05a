#include "splinemap/map_view.h"

#include <algorithm>
#include <array>
#include <cstring>
#include <utility>

#include "lib/base/read_section.h"
#include "lib/map/point_kernel.h"

namespace splinemap {
namespace {

const Tile kUntouched;

bool IsInOneTile(int32_t i, int32_t j) {
  constexpr int kLast = Tile::kSide - 4;
  return (i & (Tile::kSide - 1)) <= kLast && (j & (Tile::kSide - 1)) <= kLast;
}

const Tile& ContentOf(const StoredTile* tile, const ReadSection& section) {
  return tile == nullptr ? kUntouched : tile->Read(section);
}

// The tiles that a patch may need: of its first control point, and those next in x and y, which are
// the first again where the patch does not reach them.
std::array<TileKey, 4> SquareOf(int32_t i, int32_t j) {
  const TileKey first = TileOf(i, j);
  const TileKey last = TileOf(i + 3, j + 3);
  return {first, TileKey{last.tx, first.ty}, TileKey{first.tx, last.ty}, last};
}

// Has a patch on its way from a tile at that address, where there may be none any more.
void FetchPatch(uintptr_t tile, int32_t i, int32_t j) {
  const uintptr_t first = tile + sizeof(ControlPoint) * IndexInTile(i, j);
  for (int row = 0; row < 4; ++row) {
    __builtin_prefetch(
        reinterpret_cast<const void*>(first + sizeof(ControlPoint) * Tile::kSide * row));
  }
}

// Copies a patch that lies in several tiles, which are those of SquareOf(i, j), to where a kernel
// can read it: four control points each to rows as far apart as those of a tile.
void CopyCrossingPatch(const Tile* const* square, int32_t i, int32_t j, ControlPoint* to) {
  constexpr int kLast = Tile::kSide - 4;
  const int column = std::min(i & (Tile::kSide - 1), kLast);
  // What is in the next tile follows on the left's last columns; where nothing is, `bits` is 0.
  const int bits = 16 * ((i & (Tile::kSide - 1)) - column);
  for (int row = 0; row < 4; ++row) {
    const Tile* const* tiles = square + 2 * (((j + row) >> 5) - (j >> 5));
    uint64_t left;
    uint64_t right;
    std::memcpy(&left, &tiles[0]->control_points[IndexInTile(column, j + row)], sizeof(left));
    std::memcpy(&right, &tiles[1]->control_points[IndexInTile(0, j + row)], sizeof(right));
    // Shifted twice since a shift by 64 is none.
    const uint64_t four = left >> bits | right << 1 << (63 - bits);
    std::memcpy(to + Tile::kSide * row, &four, sizeof(four));
  }
}

// What `use` makes of the patch from control point (i, j) on, of tiles as `content_of` has them by
// key.
template <typename ContentOfKey, typename Use>
auto UsePatch(int32_t i, int32_t j, ContentOfKey content_of, Use use) {
  if (IsInOneTile(i, j)) return use(&content_of(TileOf(i, j)).control_points[IndexInTile(i, j)]);
  const std::array<TileKey, 4> keys = SquareOf(i, j);
  std::array<const Tile*, 4> square;
  for (int k = 0; k < 4; ++k) square[k] = &content_of(keys[k]);
  std::array<ControlPoint, 4 * Tile::kSide> rows;
  CopyCrossingPatch(square.data(), i, j, rows.data());
  return use(rows.data());
}

template <typename ContentOfKey>
SurfaceSample EvaluateAt(const KnotPosition& x, const KnotPosition& y, double knot_interval_m,
                         ContentOfKey content_of) {
  return UsePatch(x.index - 1, y.index - 1, content_of, [&](const ControlPoint* patch) {
    SurfaceSample sample;
    FastestPointKernel().evaluate_point(patch, x.t, y.t, 1 / knot_interval_m, sample);
    return sample;
  });
}

// Each step runs over a block of points before the next begins: a processor waits for many points
// of a large map at once if what it does for each of them is little.
class BlockEvaluator {
 public:
  explicit BlockEvaluator(const MapView& map)
      : map_(map), kernel_(FastestPointKernel()), knots_per_m_(1 / map.options.knot_interval_m) {}

  // Requires whole fours, at most PointBlock::kSize.
  void Evaluate(const Eigen::Vector2d* points_m, int count, SurfaceSample* samples) {
    const double knot_interval_m = map_.options.knot_interval_m;
    const bool all_on_map = kernel_.locate(points_m, count, knot_interval_m, block_);
    {
      const ReadSection section;
      FindTiles(count, section);
      FindPatches(count);
      kernel_.evaluate(block_, count, knots_per_m_, samples);
    }
    if (all_on_map) return;
    for (int n = 0; n < count; ++n) {
      const bool is_on_map = LocateKnot(points_m[n].x(), knot_interval_m) &&
                             LocateKnot(points_m[n].y(), knot_interval_m);
      if (!is_on_map) samples[n] = {};
    }
  }

 private:
  // Neighbours often need the same tiles, which are looked up once then.
  void FindTiles(int count, const ReadSection& section) {
    num_crossing_ = 0;
    int num_keys = 0;
    int square_begin = -1;  // of the crossing patch before
    for (int n = 0; n < count; ++n) {
      const int32_t i = block_.i[n];
      const int32_t j = block_.j[n];
      if (IsInOneTile(i, j)) {
        const TileKey key = TileOf(i, j);
        if (num_keys == 0 || keys_[num_keys - 1] != key) keys_[num_keys++] = key;
        key_indices_[n] = num_keys - 1;
        continue;
      }
      const std::array<TileKey, 4> square = SquareOf(i, j);
      if (square_begin < 0 || keys_[square_begin] != square.front() ||
          keys_[square_begin + 3] != square.back()) {
        square_begin = num_keys;
        for (const TileKey& key : square) keys_[num_keys++] = key;
      }
      key_indices_[n] = square_begin;
      crossing_[num_crossing_++] = n;
    }
    map_.tiles.FindMany({keys_.data(), static_cast<size_t>(num_keys)}, absl::MakeSpan(found_));
    for (int k = 0; k < num_keys; ++k) tiles_[k] = &ContentOf(found_[k], section);
  }

  // A processor waits for many points of a large map at once if their control points are fetched
  // before any of them is evaluated.
  void FindPatches(int count) {
    for (int n = 0; n < count; ++n) {
      const Tile* const tile = tiles_[key_indices_[n]];
      FetchPatch(reinterpret_cast<uintptr_t>(tile), block_.i[n], block_.j[n]);
      block_.patches[n] = &tile->control_points[IndexInTile(block_.i[n], block_.j[n])];
    }
    ControlPoint* copy = nullptr;
    for (int k = 0; k < num_crossing_; ++k) {
      const int n = crossing_[k];
      // Neighbours often have the same patch.
      const bool is_copied = k > 0 && block_.i[n] == block_.i[crossing_[k - 1]] &&
                             block_.j[n] == block_.j[crossing_[k - 1]];
      if (!is_copied) {
        copy = &copies_[4 * (k % 8) + 4 * Tile::kSide * (k / 8)];
        CopyCrossingPatch(&tiles_[key_indices_[n]], block_.i[n], block_.j[n], copy);
      }
      block_.patches[n] = copy;
    }
  }

  const MapView& map_;
  const PointKernel& kernel_;
  const double knots_per_m_;

  PointBlock block_;
  std::array<TileKey, 4 * PointBlock::kSize> keys_;
  std::array<const StoredTile*, 4 * PointBlock::kSize> found_;  // by key
  std::array<const Tile*, 4 * PointBlock::kSize> tiles_;        // the same
  // By point: its tile, or the first of the four of its square.
  std::array<int, PointBlock::kSize> key_indices_;
  // Points whose patches lie in several tiles, and copies of those, eight side by side.
  int num_crossing_ = 0;
  std::array<int, PointBlock::kSize> crossing_;
  std::array<ControlPoint, 16 * PointBlock::kSize> copies_;
};

}  // namespace

SurfaceSample MapView::Evaluate(double x_m, double y_m) const {
  const auto x = LocateKnot(x_m, options.knot_interval_m);
  const auto y = LocateKnot(y_m, options.knot_interval_m);
  if (!x || !y) return {};
  const ReadSection section;
  return EvaluateAt(*x, *y, options.knot_interval_m, [&](TileKey key) -> const Tile& {
    const TileTree::Hint* hint = nullptr;
    const StoredTile* const tile = tiles.Find(key, hint);
    if (tile == nullptr) return kUntouched;
    FetchPatch(hint->address(), x->index - 1, y->index - 1);
    const Tile& content = tile->Read(section);
    hint->Set(&content);
    return content;
  });
}

PathReader::PathReader(std::shared_ptr<const MapView> map) : map_(std::move(map)) {}

SurfaceSample PathReader::Evaluate(double x_m, double y_m) {
  const double knot_interval_m = map_->options.knot_interval_m;
  const auto x = LocateKnot(x_m, knot_interval_m);
  const auto y = LocateKnot(y_m, knot_interval_m);
  if (!x || !y) return {};
  return EvaluateAt(*x, *y, knot_interval_m,
                    [&](TileKey key) -> const Tile& { return TileAt(key); });
}

const Tile& PathReader::TileAt(TileKey key) {
  Place& place = places_[(key.ty & 1) << 1 | (key.tx & 1)];
  if (place.tile == nullptr || place.key != key) {
    static const auto kAbsent = std::make_shared<const Tile>();
    const StoredTile* const stored = map_->tiles.Find(key);
    place = {key, stored == nullptr ? kAbsent : stored->TryGet()};
    if (place.tile == nullptr) return *kAbsent;  // the next time it may be read
  }
  return *place.tile;
}

Eigen::Matrix2d MapView::Hessian(double x_m, double y_m) const {
  const auto x = LocateKnot(x_m, options.knot_interval_m);
  const auto y = LocateKnot(y_m, options.knot_interval_m);
  if (!x || !y) return Eigen::Matrix2d::Zero();
  const ReadSection section;
  const auto content_of = [&](TileKey key) -> const Tile& {
    return ContentOf(tiles.Find(key), section);
  };
  return UsePatch(x->index - 1, y->index - 1, content_of, [&](const ControlPoint* units) {
    ControlPatch patch;
    for (int k = 0; k < 16; ++k) {
      patch(k / 4, k % 4) = kLogOddsPerUnit * units[Tile::kSide * (k / 4) + k % 4];
    }
    return PatchHessian(patch, x->t, y->t, options.knot_interval_m);
  });
}

void MapView::EvaluateMany(absl::Span<const Eigen::Vector2d> points_m,
                           absl::Span<SurfaceSample> samples) const {
  BlockEvaluator evaluator(*this);
  const size_t fours = points_m.size() & ~size_t{3};
  for (size_t begin = 0; begin < fours; begin += PointBlock::kSize) {
    const size_t count = std::min<size_t>(PointBlock::kSize, fours - begin);
    evaluator.Evaluate(&points_m[begin], static_cast<int>(count), &samples[begin]);
  }
  if (fours == points_m.size()) return;
  std::array<Eigen::Vector2d, 4> last_points_m;
  std::array<SurfaceSample, 4> last_samples;
  last_points_m.fill(points_m.back());
  std::copy(points_m.begin() + fours, points_m.end(), last_points_m.begin());
  evaluator.Evaluate(last_points_m.data(), 4, last_samples.data());
  std::copy_n(last_samples.begin(), points_m.size() - fours, samples.begin() + fours);
}

}  // namespace splinemap
