#include "lib/query/ray_caster.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "lib/geometry/angle.h"
#include "lib/query/bezier_net.h"

namespace splinemap {
namespace {

constexpr double kTolerance = 1e-6;  // knot intervals

using Sextic = std::array<double, 7>;  // Bezier coefficients

struct Halves {
  Sextic first;
  Sextic second;
};

// De Casteljau's algorithm at 1/2.
Halves Split(Sextic c) {
  Halves halves;
  for (int k = 0; k < 7; ++k) {
    halves.first[k] = c[0];
    halves.second[6 - k] = c[6 - k];
    for (int m = 0; m < 6 - k; ++m) c[m] = (c[m] + c[m + 1]) / 2;
  }
  return halves;
}

// Where in [begin, end] a polynomial is `threshold` first; as far as kTolerance tells.
std::optional<double> FirstReaching(const Sextic& c, double threshold, double begin, double end) {
  if (c[0] >= threshold) return begin;
  if (*std::max_element(c.begin(), c.end()) < threshold) return std::nullopt;
  if (end - begin < kTolerance) return begin;
  const Halves halves = Split(c);
  const double middle = (begin + end) / 2;
  const auto reached = FirstReaching(halves.first, threshold, begin, middle);
  return reached ? reached : FirstReaching(halves.second, threshold, middle, end);
}

int32_t CellOf(double coordinate, int32_t first, int32_t side) {
  const double cell = std::floor(coordinate);
  return static_cast<int32_t>(std::clamp(cell, double{1} * first, double{1} * first + side - 1));
}

// From where to where the line is within [low, high] in one coordinate.
void Clip(double origin, double direction, double low, double high, double& begin, double& end) {
  if (direction == 0) {
    if (origin < low || origin > high) end = -kInfinity;
    return;
  }
  const double a = (low - origin) / direction;
  const double b = (high - origin) / direction;
  begin = std::max(begin, std::min(a, b));
  end = std::min(end, std::max(a, b));
}

}  // namespace

RayCaster::RayCaster(const SurfaceBounds& bounds, double occupied_log_odds, UnknownPolicy unknown)
    : knot_interval_m_(bounds.map()->options.knot_interval_m),
      threshold_(occupied_log_odds * kUnitsPerLogOdds),
      unknown_(unknown),
      bounds_(bounds),
      patches_(bounds.map()->tiles),
      tile_(bounds_.Find(tile_key_)) {}

RaysQuery::End RayCaster::Cast(const Ray& ray) {
  const Line line{ray.origin_m / knot_interval_m_, UnitVector(ray.bearing_rad)};
  double begin = 0;
  double end = ray.max_range_m / knot_interval_m_;
  const TileBox& box = bounds_.box();
  constexpr double kSide = Tile::kSide;
  Clip(line.origin.x(), line.direction.x(), kSide * box.tx0, kSide * box.tx1, begin, end);
  Clip(line.origin.y(), line.direction.y(), kSide * box.ty0, kSide * box.ty1, begin, end);
  const bool is_outside = box.IsEmpty() || begin > end;
  if (unknown_ == UnknownPolicy::kBlocked && (is_outside || begin > 0))
    return {Occupancy::kUnknown, 0};
  if (is_outside) return {Occupancy::kFree, ray.max_range_m};
  const End found = Follow(line, begin, end);
  const double range_m = found.range * knot_interval_m_;
  if (found.occupancy != Occupancy::kFree) {
    return {found.occupancy, std::min(range_m, ray.max_range_m)};
  }
  const bool leaves_map = end < ray.max_range_m / knot_interval_m_;
  if (unknown_ == UnknownPolicy::kBlocked && leaves_map) return {Occupancy::kUnknown, range_m};
  return {Occupancy::kFree, ray.max_range_m};
}

RayCaster::End RayCaster::Follow(const Line& line, double begin, double end) {
  const TileBox& box = bounds_.box();
  constexpr int32_t kSide = Tile::kSide;
  const Eigen::Vector2d first = line.At(begin);
  int32_t i = CellOf(first.x(), kSide * box.tx0, kSide * (box.tx1 - box.tx0));
  int32_t j = CellOf(first.y(), kSide * box.ty0, kSide * (box.ty1 - box.ty0));
  while (true) {
    const Square square = LargestClearSquare(i, j);
    const double exit_x =
        line.direction.x() > 0   ? (square.i + square.side - line.origin.x()) / line.direction.x()
        : line.direction.x() < 0 ? (square.i - line.origin.x()) / line.direction.x()
                                 : kInfinity;
    const double exit_y =
        line.direction.y() > 0   ? (square.j + square.side - line.origin.y()) / line.direction.y()
        : line.direction.y() < 0 ? (square.j - line.origin.y()) / line.direction.y()
                                 : kInfinity;
    const double exit = std::max(begin, std::min({exit_x, exit_y, end}));
    if (square.side == 1) {
      if (const auto found = FollowOverCell(line, square, begin, exit)) return *found;
    }
    if (exit >= end) return {Occupancy::kFree, end};
    begin = exit;
    if (exit_x <= exit_y) {
      i = line.direction.x() > 0 ? square.i + square.side : square.i - 1;
      j = CellOf(line.At(exit).y(), square.j, square.side);
    } else {
      j = line.direction.y() > 0 ? square.j + square.side : square.j - 1;
      i = CellOf(line.At(exit).x(), square.i, square.side);
    }
  }
}

// The tile or block that holds a cell, where there is nothing to be found in it; else the cell.
RayCaster::Square RayCaster::LargestClearSquare(int32_t i, int32_t j) {
  const auto is_clear = [&](const Bounds& bounds) {
    return bounds.upper < threshold_ && (bounds.all_known || unknown_ == UnknownPolicy::kFree);
  };
  if (const TileKey key = TileOf(i, j); key != tile_key_) {
    tile_key_ = key;
    tile_ = bounds_.Find(key);
  }
  constexpr int32_t kTileSide = Tile::kSide;
  constexpr int32_t kBlockSide = TileBounds::kBlockSide;
  if (is_clear(tile_ == nullptr ? Bounds() : tile_->whole)) {
    return {i & -kTileSide, j & -kTileSide, kTileSide};
  }
  if (tile_ == nullptr) return {i, j, 1};
  const int block = ((j & (kTileSide - 1)) / kBlockSide) * TileBounds::kBlocks +
                    (i & (kTileSide - 1)) / kBlockSide;
  if (is_clear(tile_->blocks[block])) return {i & -kBlockSide, j & -kBlockSide, kBlockSide};
  return {i, j, 1};
}

std::optional<RayCaster::End> RayCaster::FollowOverCell(const Line& line, const Square& cell,
                                                        double begin, double end) {
  const CellPatch patch = patches_.Read(cell.i, cell.j);
  const Bounds bounds = patch.bounds();
  if (bounds.upper < threshold_ && (bounds.all_known || unknown_ == UnknownPolicy::kFree)) {
    return std::nullopt;
  }
  // Where the nearest control point changes.
  std::array<double, 4> ends{begin, end, end, end};
  int num_ends = 2;
  if (!bounds.all_known) {
    const Eigen::Vector2d middle(cell.i + 0.5, cell.j + 0.5);
    for (int axis = 0; axis < 2; ++axis) {
      const double range = (middle[axis] - line.origin[axis]) / line.direction[axis];
      if (range > begin && range < end) {
        ends[num_ends - 1] = range;
        ends[num_ends++] = end;
      }
    }
    if (ends[1] > ends[2]) std::swap(ends[1], ends[2]);
  }
  const Eigen::Vector2d corner(cell.i, cell.j);
  const auto in_cell = [&](double range) {
    return Eigen::Vector2d((line.At(range) - corner).cwiseMax(0).cwiseMin(1));
  };
  for (int k = 0; k + 1 < num_ends; ++k) {
    const Eigen::Vector2d middle = in_cell((ends[k] + ends[k + 1]) / 2);
    if (!patch.IsKnown(middle.x() >= 0.5 ? 1 : 0, middle.y() >= 0.5 ? 1 : 0)) {
      if (unknown_ == UnknownPolicy::kBlocked) return End{Occupancy::kUnknown, ends[k]};
      continue;
    }
    if (bounds.upper < threshold_) continue;
    const Eigen::Vector2d from = in_cell(ends[k]);
    const Eigen::Vector2d to = in_cell(ends[k + 1]);
    const BezierNet net = BezierNet::OfCell(patch).Part(from.x(), to.x(), from.y(), to.y());
    const auto reached = FirstReaching(net.Diagonal(), threshold_, ends[k], ends[k + 1]);
    if (reached) return End{Occupancy::kOccupied, *reached};
  }
  return std::nullopt;
}

}  // namespace splinemap
