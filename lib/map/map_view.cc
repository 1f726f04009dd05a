#include "splinemap/map_view.h"

#include <algorithm>
#include <array>
#include <bit>
#include <cstring>
#include <utility>

#include "lib/base/read_section.h"
#include "lib/map/point_kernel.h"

namespace splinemap {
namespace {

const Tile kUntouched;

// A patch whose first control point is at `index` of a tile lies in that tile as far as this column
// and row.
constexpr int kLast = Tile::kSide - 4;
bool IsCrossingX(int index) { return (index & 31) > kLast; }
bool IsCrossingY(int index) { return index > IndexInTile(31, kLast); }
bool IsCrossing(int index) { return IsCrossingX(index) | IsCrossingY(index); }

// Reads tiles of a tree, which are there as long as this.
class TileReading {
 public:
  explicit TileReading(const TileTree& tiles) : tiles_(tiles) {}

  const Tile& At(TileKey key) const { return At(tiles_.FindSlot(key)); }
  // Does not touch the entry of a tile that somebody has read since one left memory. So it is not
  // marked as used either, until the next one leaves.
  const Tile& At(const TileTree::Slot& slot) const {
    if (const void* const content = slot.hint.Get(num_evictions_)) {
      return *static_cast<const Tile*>(content);
    }
    const Tile* const content = slot.value ? slot.value->TryRead(section_) : nullptr;
    if (content == nullptr) return kUntouched;
    slot.hint.Set(content, num_evictions_);
    return *content;
  }

 private:
  const TileTree& tiles_;
  const ReadSection section_;
  const uint64_t num_evictions_ = StoredTile::NumEvictions();  // since the section began
};

// The following have a patch on its way from memory. GCC drops calls of what does nothing else, and
// so they have to be inlined.
[[gnu::always_inline]] inline void FetchPatch(const ControlPoint* first) {
  for (int row = 0; row < 4; ++row) __builtin_prefetch(first + Tile::kSide * row);
}

// The tiles of a patch, as `at` has them by key: of its first control point, and those next in x,
// in y, and in both; where the patch does not reach them, others that it has.
template <typename T, typename At>
std::array<T, 4> SquareOf(TileKey key, int index, T first, At at) {
  const int x = IsCrossingX(index);
  const int y = IsCrossingY(index);
  const T last = at(TileKey{key.tx + x, key.ty + y});
  if ((x & y) == 0) return {first, x != 0 ? last : first, y != 0 ? last : first, last};
  return {first, at(TileKey{key.tx + 1, key.ty}), at(TileKey{key.tx, key.ty + 1}), last};
}

using Square = std::array<const Tile*, 4>;

struct CrossingPatch {
  Square square;
  int index;  // of its first control point in the first tile
};

// Row `row` of the patch whose first control point is at `index` in the first tile: where its first
// four control points that lie in the left tile are, or those before them if there are fewer; and
// where the row goes on.
struct CrossingRow {
  CrossingRow(const Square& square, int index, int row) {
    const int j = (index >> 5) + row;
    const Tile* const* const tiles = &square[2 * (j >> 5)];
    left = &tiles[0]->control_points[IndexInTile(std::min(index & 31, kLast), j)];
    right = &tiles[1]->control_points[IndexInTile(0, j)];
  }
  const ControlPoint* left;
  const ControlPoint* right;
};

[[gnu::always_inline]] inline void FetchCrossingPatch(const Square& square, int index) {
  for (int row = 0; row < 4; ++row) {
    const CrossingRow at(square, index, row);
    __builtin_prefetch(at.left);
    __builtin_prefetch(at.right);
  }
}

// Copies a patch that lies in several tiles to where a kernel can read it: four control points each
// to rows as far apart as those of a tile.
void CopyCrossingPatch(const Square& square, int index, ControlPoint* to) {
  // What is in the next tile follows on the left's last columns; where nothing is, `bits` is 0.
  const int bits = 16 * std::max((index & 31) - kLast, 0);
  for (int row = 0; row < 4; ++row) {
    const CrossingRow at(square, index, row);
    uint64_t left;
    uint64_t right;
    std::memcpy(&left, at.left, sizeof(left));
    std::memcpy(&right, at.right, sizeof(right));
    // Shifted twice since a shift by 64 is none.
    const uint64_t four = left >> bits | right << 1 << (63 - bits);
    std::memcpy(to + Tile::kSide * row, &four, sizeof(four));
  }
}

// What `use` makes of the patch from control point (i, j) on, of tiles as `content_of` has them by
// key.
template <typename ContentOfKey, typename Use>
auto UsePatch(int32_t i, int32_t j, ContentOfKey content_of, Use use) {
  const TileKey key = TileOf(i, j);
  const int index = IndexInTile(i, j);
  const Tile& first = content_of(key);
  if (!IsCrossing(index)) return use(&first.control_points[index]);
  const Square square =
      SquareOf(key, index, &first, [&](TileKey other) { return &content_of(other); });
  std::array<ControlPoint, 4 * Tile::kSide> rows;
  CopyCrossingPatch(square, index, rows.data());
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

// Evaluates points in blocks. Each step runs over a block before the next begins, and memory is
// asked for what the next block needs before this one is computed: a processor waits for many
// points of a large map at once if what it does for each of them is little.
class BlockEvaluator {
 public:
  explicit BlockEvaluator(const MapView& map) : map_(map), kernel_(FastestPointKernel()) {}

  // Requires whole eights.
  void Evaluate(absl::Span<const Eigen::Vector2d> points_m, SurfaceSample* samples) {
    const TileReading reading(map_.tiles);
    Block* block = &blocks_[0];
    Block* next = &blocks_[1];
    Find(points_m.subspan(0, PointBlock::kSize), reading, *block);
    for (int n = 0; n < block->count; ++n) FetchPatch(block->patches[n]);
    while (block->count > 0) {
      const size_t count = static_cast<size_t>(block->count);
      Find(points_m.subspan(count, PointBlock::kSize), reading, *next);
      CopyCrossing(*block);
      kernel_.evaluate(*block, *next, 1 / map_.options.knot_interval_m, samples);
      if (!block->all_on_map) ForgetOffMap(points_m.first(count), samples);
      points_m.remove_prefix(count);
      samples += count;
      std::swap(block, next);
    }
  }

 private:
  struct Block : PointBlock {
    bool all_on_map;
    // Patches that lie in several tiles, and room for copies of them, eight side by side.
    int num_crossing;
    std::array<CrossingPatch, kSize> crossing;
    std::array<ControlPoint, 16 * kSize> copies;

    ControlPoint* Copy(int c) { return &copies[4 * (c % 8) + 4 * Tile::kSide * (c / 8)]; }
  };

  void Find(absl::Span<const Eigen::Vector2d> points_m, const TileReading& reading, Block& block) {
    block.count = static_cast<int>(points_m.size());
    block.all_on_map = kernel_.locate(points_m.data(), map_.options.knot_interval_m, block);
    ListTiles(block);
    map_.tiles.FindSlots({keys_, static_cast<size_t>(num_keys_)}, absl::MakeSpan(slots_));
    for (int k = 0; k < num_keys_; ++k) tiles_[k] = &reading.At(*slots_[k]);
    for (int n = 0; n < block.count; ++n) {
      block.patches[n] = &tiles_[places_[n]]->control_points[block.indices[n]];
    }
    PlaceCrossing(block);
  }

  // Neighbours often have the same patch.
  void PlaceCrossing(Block& block) {
    block.num_crossing = 0;
    for (int k = 0; k < num_crossing_; ++k) {
      const int n = crossing_[k];
      const int before = k > 0 ? crossing_[k - 1] : n;
      if (k == 0 || block.indices[n] != block.indices[before] ||
          block.keys[n] != block.keys[before]) {
        CrossingPatch& patch = block.crossing[block.num_crossing++];
        patch.index = block.indices[n];
        for (int corner = 0; corner < 4; ++corner) {
          patch.square[corner] = tiles_[squares_[k][corner]];
        }
        FetchCrossingPatch(patch.square, patch.index);
      }
      block.patches[n] = block.Copy(block.num_crossing - 1);
    }
  }

  // Neighbours often need the same tiles, which are looked up once then.
  void ListTiles(const Block& block) {
    int num_keys = 0;
    int num_crossing = 0;
    for (int n = 0; n < block.count; ++n) {
      if (n == 0 || block.keys[n] != block.keys[n - 1]) {
        keys_[num_keys++] = std::bit_cast<TileKey>(block.keys[n]);
      }
      places_[n] = num_keys - 1;
      crossing_[num_crossing] = n;
      num_crossing -= block.is_crossing[n];
    }
    const auto list = [&](TileKey key) {
      if (keys_[num_keys - 1] != key) keys_[num_keys++] = key;
      return num_keys - 1;
    };
    for (int k = 0; k < num_crossing; ++k) {
      const int n = crossing_[k];
      const auto key = std::bit_cast<TileKey>(block.keys[n]);
      squares_[k] = SquareOf(key, block.indices[n], places_[n], list);
    }
    num_keys_ = num_keys;
    num_crossing_ = num_crossing;
  }

  static void CopyCrossing(Block& block) {
    for (int c = 0; c < block.num_crossing; ++c) {
      CopyCrossingPatch(block.crossing[c].square, block.crossing[c].index, block.Copy(c));
    }
  }

  void ForgetOffMap(absl::Span<const Eigen::Vector2d> points_m, SurfaceSample* samples) const {
    const double knot_interval_m = map_.options.knot_interval_m;
    for (size_t n = 0; n < points_m.size(); ++n) {
      const bool is_on_map = LocateKnot(points_m[n].x(), knot_interval_m) &&
                             LocateKnot(points_m[n].y(), knot_interval_m);
      if (!is_on_map) samples[n] = {};
    }
  }

  const MapView& map_;
  const PointKernel& kernel_;
  std::array<Block, 2> blocks_;

  // Of a block: the tiles that it needs, and which of them has the first control point of a point's
  // patch.
  int num_keys_ = 0;
  union {  // not set to zeros before
    TileKey keys_[4 * PointBlock::kSize];
  };
  std::array<const TileTree::Slot*, 4 * PointBlock::kSize> slots_;
  std::array<const Tile*, 4 * PointBlock::kSize> tiles_;
  std::array<int, PointBlock::kSize> places_;
  // Points whose patches lie in several tiles, and which of the tiles are those.
  int num_crossing_ = 0;
  std::array<int, PointBlock::kSize> crossing_;
  std::array<std::array<int, 4>, PointBlock::kSize> squares_;
};

}  // namespace

SurfaceSample MapView::Evaluate(double x_m, double y_m) const {
  const auto x = LocateKnot(x_m, options.knot_interval_m);
  const auto y = LocateKnot(y_m, options.knot_interval_m);
  if (!x || !y) return {};
  const TileReading reading(tiles);
  return EvaluateAt(*x, *y, options.knot_interval_m,
                    [&](TileKey key) -> const Tile& { return reading.At(key); });
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
  const TileReading reading(tiles);
  const auto content_of = [&](TileKey key) -> const Tile& { return reading.At(key); };
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
  // So many in one go, since memory waits for it.
  constexpr size_t kAtOnce = 16 * PointBlock::kSize;
  BlockEvaluator evaluator(*this);
  const size_t whole = points_m.size() & ~size_t{7};
  for (size_t begin = 0; begin < whole; begin += kAtOnce) {
    evaluator.Evaluate(points_m.subspan(begin, std::min(kAtOnce, whole - begin)), &samples[begin]);
  }
  if (whole == points_m.size()) return;
  std::array<Eigen::Vector2d, 8> last_points_m;
  std::array<SurfaceSample, 8> last_samples;
  last_points_m.fill(points_m.back());
  std::copy(points_m.begin() + whole, points_m.end(), last_points_m.begin());
  evaluator.Evaluate(last_points_m, last_samples.data());
  std::copy_n(last_samples.begin(), points_m.size() - whole, samples.begin() + whole);
}

}  // namespace splinemap
