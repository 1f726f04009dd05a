#include "lib/map/placed_tile.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>

#include "absl/container/flat_hash_set.h"
#include "lib/geometry/angle.h"

namespace splinemap {
namespace {

constexpr int kSide = Tile::kSide;

// Places are rounded to 1/256 knot interval.
constexpr int kPhaseBits = 8;
constexpr int64_t kPhases = 1 << kPhaseBits;
int64_t PhasesOf(double knots) { return RoundToInt(knots * kPhases); }

// Rounded, so that sines of other libraries are the same where somebody takes them.
double Rounded(double cosine) {
  constexpr double kUnits = int64_t{1} << 36;
  return static_cast<double>(RoundToInt(cosine * kUnits)) / kUnits;
}

KnotRange KnotsOf(TileKey key) {
  const int64_t i = int64_t{kSide} * key.tx;
  const int64_t j = int64_t{kSide} * key.ty;
  return {i, j, i + kSide - 1, j + kSide - 1};
}

bool Intersect(const KnotRange& a, const KnotRange& b) {
  return a.i0 <= b.i1 && b.i0 <= a.i1 && a.j0 <= b.j1 && b.j0 <= a.j1;
}

// The control points of a layer that one tile of the map is made of.
class Window {
 public:
  // At 45 degrees 31 knots are 43.9 of the layer's, and interpolation needs 4 more.
  static constexpr int kMaxSide = 50;

  Window(const TileTree& layer, const KnotRange& box) : i0_(box.i0), j0_(box.j0) {
    for (int64_t ty = box.j0 >> 5; ty <= box.j1 >> 5; ++ty) {
      for (int64_t tx = box.i0 >> 5; tx <= box.i1 >> 5; ++tx) Add(layer, box, tx, ty);
    }
  }

  bool IsEmpty() const { return is_empty_; }
  // The first `count` of a row, from the first row on.
  void CopyRow(int row, int count, ControlPoint* to) const {
    std::copy_n(&points_[kMaxSide * row], count, to);
  }
  int At(int64_t i, int64_t j) const { return points_[kMaxSide * (j - j0_) + (i - i0_)]; }

 private:
  void Add(const TileTree& layer, const KnotRange& box, int64_t tx, int64_t ty) {
    constexpr int64_t kMax = kMaxKnotIndex >> 5;
    if (std::max(std::abs(tx), std::abs(ty)) > kMax) return;
    const std::shared_ptr<const Tile> tile =
        FindTile(layer, {static_cast<int32_t>(tx), static_cast<int32_t>(ty)});
    if (tile == nullptr) return;
    is_empty_ = false;
    const int64_t i_begin = std::max(box.i0, kSide * tx);
    const int64_t i_end = std::min(box.i1 + 1, kSide * (tx + 1));
    const int64_t j_end = std::min(box.j1 + 1, kSide * (ty + 1));
    for (int64_t j = std::max(box.j0, kSide * ty); j < j_end; ++j) {
      std::copy_n(&tile->control_points[kSide * (j - kSide * ty) + (i_begin - kSide * tx)],
                  i_end - i_begin, &points_[kMaxSide * (j - j0_) + (i_begin - i0_)]);
    }
  }

  const int64_t i0_;
  const int64_t j0_;
  bool is_empty_ = true;
  std::array<ControlPoint, kMaxSide * kMaxSide> points_{};
};

// Weights of the four control points around a place n / 256 beyond the second of them, in 2^-25:
// Catmull-Rom's, which make straight lines and parabolas of such.
constexpr int kWeightBits = 3 * kPhaseBits + 1;
struct Weights {
  std::array<int64_t, 4> w;

  explicit Weights(int64_t n) {
    const int64_t rest = kPhases - n;
    w = {-n * rest * rest, 3 * n * n * n - 5 * kPhases * n * n + 2 * kPhases * kPhases * kPhases,
         3 * rest * rest * rest - 5 * kPhases * rest * rest + 2 * kPhases * kPhases * kPhases,
         -rest * n * n};
  }
};

// Nearest, halves up.
int64_t ShiftRight(int64_t number, int bits) {
  return (number + (int64_t{1} << (bits - 1))) >> bits;
}

// At a place of the layer, in phases, where the nearest control point is known. Those that are not
// count as that one.
ControlPoint Interpolated(const Window& window, int64_t x, int64_t y, int nearest) {
  constexpr int kRowBits = 13;  // dropped of a row, so that all is within 64 bits
  const int64_t i = x >> kPhaseBits;
  const int64_t j = y >> kPhaseBits;
  const int64_t phase_x = x & (kPhases - 1);
  const int64_t phase_y = y & (kPhases - 1);
  const Weights of_x(phase_x);
  const Weights of_y(phase_y);
  int least = nearest;
  int greatest = nearest;
  int64_t sum = 0;
  for (int row = 0; row < 4; ++row) {
    int64_t row_sum = 0;
    for (int column = 0; column < 4; ++column) {
      const int point = window.At(i - 1 + column, j - 1 + row);
      if (point == 0) continue;
      row_sum += of_x.w[column] * (point - nearest);
      const bool is_next = (column == 1 || (column == 2 && phase_x != 0)) &&
                           (row == 1 || (row == 2 && phase_y != 0));
      if (!is_next) continue;
      least = std::min(least, point);
      greatest = std::max(greatest, point);
    }
    sum += of_y.w[row] * ShiftRight(row_sum, kRowBits);
  }
  const int64_t value = nearest + ShiftRight(sum, 2 * kWeightBits - kRowBits);
  const auto kept = static_cast<ControlPoint>(std::clamp<int64_t>(value, least, greatest));
  return kept == 0 ? ControlPoint{1} : kept;
}

// The least or the greatest of some, as CoarserTile() takes them: 0 counts unless all are 0.
ControlPoint ExtremeOf(const Window& window, const KnotRange& box, Statistic statistic) {
  const bool is_min = statistic == Statistic::kMin;
  bool is_touched = false;
  int extreme = window.At(box.i0, box.j0);
  for (int64_t j = box.j0; j <= box.j1; ++j) {
    for (int64_t i = box.i0; i <= box.i1; ++i) {
      const int point = window.At(i, j);
      is_touched = is_touched || point != 0;
      extreme = is_min ? std::min(extreme, point) : std::max(extreme, point);
    }
  }
  if (extreme == 0 && is_touched) extreme = is_min ? -1 : 1;
  return static_cast<ControlPoint>(extreme);
}

}  // namespace

KnotPlacement::KnotPlacement(const FixedPose2& map_T_layer, double knot_interval_m,
                             LevelOfDetail level_of_detail)
    : x_knots_(static_cast<double>(map_T_layer.x) / FixedPose2::kUnitsPerMetre / knot_interval_m),
      y_knots_(static_cast<double>(map_T_layer.y) / FixedPose2::kUnitsPerMetre / knot_interval_m),
      statistic_(level_of_detail.statistic),
      finer_(std::ldexp(1, -level_of_detail.level)) {
  const Eigen::Vector2d x_axis = UnitVector(map_T_layer.yaw * (std::numbers::pi / (1u << 31)));
  cosine_ = Rounded(x_axis.x());
  sine_ = Rounded(x_axis.y());
  const double tolerance = kRounding * finer_;
  const auto x_whole = static_cast<double>(RoundToInt(x_knots_));
  const auto y_whole = static_cast<double>(RoundToInt(y_knots_));
  // Minima and maxima are of squares that begin at their knots, and do not when they are turned.
  const bool is_turned_exactly = statistic_ == Statistic::kMean
                                     ? static_cast<uint32_t>(map_T_layer.yaw) << 2 == 0
                                     : map_T_layer.yaw == 0;
  is_exact_ = is_turned_exactly && std::abs(x_knots_ - x_whole) <= tolerance &&
              std::abs(y_knots_ - y_whole) <= tolerance;
  if (!is_exact_) return;
  x_knots_ = x_whole;
  y_knots_ = y_whole;
}

bool KnotPlacement::IsShift() const { return is_exact_ && cosine_ == 1; }

bool KnotPlacement::IsIdentity() const { return IsShift() && x_knots_ == 0 && y_knots_ == 0; }

KnotPlacement::Place KnotPlacement::PlaceOf(int64_t i, int64_t j) const {
  const double x = static_cast<double>(i) - x_knots_;
  const double y = static_cast<double>(j) - y_knots_;
  return {cosine_ * x + sine_ * y, cosine_ * y - sine_ * x};
}

// The squares of the layer that have a part in the one of the map whose first control point is
// there: all that its finer ones, of which it has 1 / finer_ each way, are interpolated between.
KnotRange KnotPlacement::SquaresUnder(const Place& place) const {
  if (is_exact_) {
    const int64_t i = RoundToInt(place.x);
    const int64_t j = RoundToInt(place.y);
    return {i, j, i, j};
  }
  const double last = 1 - finer_;
  const double x0 = place.x + last * (std::min(cosine_, 0.0) + std::min(sine_, 0.0));
  const double y0 = place.y + last * (std::min(cosine_, 0.0) + std::min(-sine_, 0.0));
  const double x1 = place.x + last * (std::max(cosine_, 0.0) + std::max(sine_, 0.0)) + finer_;
  const double y1 = place.y + last * (std::max(cosine_, 0.0) + std::max(-sine_, 0.0)) + finer_;
  return {FloorToInt(x0), FloorToInt(y0), FloorToInt(x1), FloorToInt(y1)};
}

KnotRange KnotPlacement::ToLayer(const KnotRange& map) const {
  KnotRange box{INT64_MAX, INT64_MAX, INT64_MIN, INT64_MIN};
  for (const int64_t j : {map.j0, map.j1}) {
    for (const int64_t i : {map.i0, map.i1}) {
      const Place place = PlaceOf(i, j);
      KnotRange needed;
      if (statistic_ != Statistic::kMean) {
        needed = SquaresUnder(place);
      } else {
        const int64_t before = is_exact_ ? 0 : 1;
        const int64_t after = is_exact_ ? 0 : 2;
        const int64_t x = PhasesOf(place.x) >> kPhaseBits;
        const int64_t y = PhasesOf(place.y) >> kPhaseBits;
        needed = {x - before, y - before, x + after, y + after};
      }
      box = {std::min(box.i0, needed.i0), std::min(box.j0, needed.j0), std::max(box.i1, needed.i1),
             std::max(box.j1, needed.j1)};
    }
  }
  return box;
}

// Those that may depend on the layer's, and some more.
KnotRange KnotPlacement::ToMap(const KnotRange& layer) const {
  constexpr double kReach = 3;
  const double x = static_cast<double>(layer.i0 + layer.i1) / 2;
  const double y = static_cast<double>(layer.j0 + layer.j1) / 2;
  const double half_x = static_cast<double>(layer.i1 - layer.i0) / 2 + kReach;
  const double half_y = static_cast<double>(layer.j1 - layer.j0) / 2 + kReach;
  const double centre_x = cosine_ * x - sine_ * y + x_knots_;
  const double centre_y = sine_ * x + cosine_ * y + y_knots_;
  const double map_half_x = std::abs(cosine_) * half_x + std::abs(sine_) * half_y;
  const double map_half_y = std::abs(sine_) * half_x + std::abs(cosine_) * half_y;
  return {FloorToInt(centre_x - map_half_x), FloorToInt(centre_y - map_half_y),
          FloorToInt(centre_x + map_half_x) + 1, FloorToInt(centre_y + map_half_y) + 1};
}

std::vector<TileKey> KeysOfPlaced(TileKey key, const KnotPlacement& placement) {
  const KnotRange of_layer = KnotsOf(key);
  const KnotRange box = placement.ToMap(of_layer);
  std::vector<TileKey> keys;
  for (int64_t ty = box.j0 >> 5; ty <= box.j1 >> 5; ++ty) {
    for (int64_t tx = box.i0 >> 5; tx <= box.i1 >> 5; ++tx) {
      constexpr int64_t kMax = kMaxKnotIndex >> 5;
      if (std::max(std::abs(tx), std::abs(ty)) > kMax) continue;
      const TileKey of_map{static_cast<int32_t>(tx), static_cast<int32_t>(ty)};
      if (Intersect(placement.ToLayer(KnotsOf(of_map)), of_layer)) keys.push_back(of_map);
    }
  }
  return keys;
}

bool PlaceTile(const TileTree& layer, TileKey key, const KnotPlacement& placement, Tile& tile) {
  const KnotRange of_map = KnotsOf(key);
  const Window window(layer, placement.ToLayer(of_map));
  if (window.IsEmpty()) return false;
  std::array<ControlPoint, Tile::kSize>& points = tile.control_points;
  if (placement.IsShift()) {
    for (int j = 0; j < kSide; ++j) window.CopyRow(j, kSide, &points[kSide * j]);
  }
  for (int k = 0; k < Tile::kSize && !placement.IsShift(); ++k) {
    const auto place = placement.PlaceOf(of_map.i0 + k % kSide, of_map.j0 + k / kSide);
    if (placement.statistic_ != Statistic::kMean) {
      points[k] = ExtremeOf(window, placement.SquaresUnder(place), placement.statistic_);
    } else {
      const int64_t x = PhasesOf(place.x);
      const int64_t y = PhasesOf(place.y);
      const int nearest =
          window.At((x + kPhases / 2) >> kPhaseBits, (y + kPhases / 2) >> kPhaseBits);
      points[k] = nearest == 0 || placement.IsExact() ? static_cast<ControlPoint>(nearest)
                                                      : Interpolated(window, x, y, nearest);
    }
  }
  return std::any_of(points.begin(), points.end(), [](ControlPoint point) { return point != 0; });
}

std::vector<TileKey> KeysUnder(TileKey key, const KnotPlacement& placement) {
  const KnotRange box = placement.ToLayer(KnotsOf(key));
  std::vector<TileKey> keys;
  for (int64_t ty = box.j0 >> 5; ty <= box.j1 >> 5; ++ty) {
    for (int64_t tx = box.i0 >> 5; tx <= box.i1 >> 5; ++tx) {
      constexpr int64_t kMax = kMaxKnotIndex >> 5;
      if (std::max(std::abs(tx), std::abs(ty)) > kMax) continue;
      keys.push_back({static_cast<int32_t>(tx), static_cast<int32_t>(ty)});
    }
  }
  return keys;
}

TileTree Placed(const TileTree& layer, const KnotPlacement& placement) {
  if (placement.IsIdentity()) return layer;
  absl::flat_hash_set<TileKey> keys;
  layer.ForEach([&](TileKey key, const TileTree::Entry&) {
    for (const TileKey of_map : KeysOfPlaced(key, placement)) keys.insert(of_map);
  });
  TileTreeEditor placed;
  for (const TileKey key : keys) {
    Tile tile;
    if (PlaceTile(layer, key, placement, tile)) {
      placed.Put(key, std::make_shared<const StoredTile>(tile), 0);
    }
  }
  return placed.Freeze();
}

TileBox TilesUnder(const Region& region, const KnotPlacement& placement, double knot_interval_m) {
  return TilesOf(placement.ToLayer(KnotsOf(region, knot_interval_m)));
}

}  // namespace splinemap
