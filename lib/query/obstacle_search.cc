#include "lib/query/obstacle_search.h"

#include <algorithm>
#include <bit>

namespace splinemap {
namespace {

// What lies no farther apart than that touches: more than rounding adds up to.
constexpr double kTouching = 1e-9;

int32_t TileIndex(double coordinate) {
  constexpr double kMax = kMaxKnotIndex;
  return static_cast<int32_t>(std::floor(std::clamp(coordinate, -kMax, kMax))) >> 5;
}

// Whether there can be control points everywhere in a rectangle.
bool IsOnMap(const Eigen::Vector2d& low, const Eigen::Vector2d& high) {
  return std::min(low.x(), low.y()) > -kMaxKnotIndex &&
         std::max(high.x(), high.y()) < kMaxKnotIndex;
}

// What of the square is occupied lies in there. That bounds the way to it far better than the
// square alone does: the error goes with the square of the side.
HalfPlane OccupiedPart(const BezierNet& net, const SearchSquare& square, double threshold) {
  const BezierNet::Plane plane = net.Above();
  const Eigen::Vector2d slope = Eigen::Vector2d(plane.slope_x, plane.slope_y) / square.side;
  const double steepness = slope.norm();
  if (steepness == 0) return {Eigen::Vector2d::UnitX(), -kInfinity};
  const Eigen::Vector2d normal = slope / steepness;
  return {normal, (threshold - plane.at_corner) / steepness + normal.dot(square.low) - kTouching};
}

}  // namespace

// The distance of a point of the way from the square is convex in the length gone, and its square
// a parabola between the places where the way passes the lines of the sides.
double NearSweep::Rank(const SearchSquare& square) const {
  const Eigen::Vector2d high = square.low + Eigen::Vector2d::Constant(square.side);
  const double reach = radius + kTouching;
  for (int axis = 0; axis < 2; ++axis) {
    if (std::max(from[axis], to[axis]) + reach < square.low[axis] ||
        std::min(from[axis], to[axis]) - reach > high[axis]) {
      return kInfinity;
    }
  }
  const double length = (to - from).norm();
  const double reach_squared = reach * reach;
  if ((square.NearestTo(from) - from).squaredNorm() <= reach_squared) return 0;
  if (length == 0) return kInfinity;
  const Eigen::Vector2d direction = (to - from) / length;
  std::array<double, 6> ends{0, length};
  int num_ends = 2;
  for (int axis = 0; axis < 2; ++axis) {
    if (direction[axis] == 0) continue;
    for (const double side : {square.low[axis], high[axis]}) {
      const double gone = (side - from[axis]) / direction[axis];
      if (!(gone > 0 && gone < length)) continue;
      int place = num_ends++;
      for (; ends[place - 1] > gone; --place) ends[place] = ends[place - 1];
      ends[place] = gone;
    }
  }
  for (int k = 0; k + 1 < num_ends; ++k) {
    // Within the piece, each coordinate is below, within or above the square.
    const Eigen::Vector2d middle = from + (ends[k] + ends[k + 1]) / 2 * direction;
    double a = 0;
    double b = 0;
    double c = -reach_squared;
    for (int axis = 0; axis < 2; ++axis) {
      const bool is_below = middle[axis] < square.low[axis];
      if (!is_below && middle[axis] <= high[axis]) continue;
      const double offset = from[axis] - (is_below ? square.low[axis] : high[axis]);
      a += direction[axis] * direction[axis];
      b += direction[axis] * offset;
      c += offset * offset;
    }
    // The least x with a x^2 + 2 b x + c <= 0.
    if (a == 0) {
      if (c <= 0) return ends[k];
      continue;
    }
    const double discriminant = b * b - a * c;
    if (discriminant < 0) continue;
    const double first = std::max((-b - std::sqrt(discriminant)) / a, ends[k]);
    const double last = (-b + std::sqrt(discriminant)) / a;
    if (first <= std::min(last, ends[k + 1])) return first;
  }
  return kInfinity;
}

double NearSweep::Rank(const HalfPlane& half) const {
  const double missing = half.offset - radius - kTouching - half.normal.dot(from);
  if (missing <= 0) return 0;
  const double length = (to - from).norm();
  const double approach = half.normal.dot(to - from);  // over the whole length
  return missing <= approach ? missing / approach * length : kInfinity;
}

bool NearSweep::Touches(const SearchSquare& square, double gone) const {
  const double length = (to - from).norm();
  const Eigen::Vector2d centre = length > 0 ? from + gone / length * (to - from) : from;
  return (square.NearestTo(centre) - centre).norm() <= radius + 2 * kTouching;
}

ObstacleSearch::ObstacleSearch(const SurfaceBounds& bounds, double occupied_log_odds,
                               UnknownPolicy unknown)
    : threshold_(occupied_log_odds * kUnitsPerLogOdds),
      unknown_(unknown),
      bounds_(bounds),
      patches_(bounds.map()->tiles) {}

ObstacleSearch::Found ObstacleSearch::Nearest(const NearPoint& ranking) { return Search(ranking); }

ObstacleSearch::Found ObstacleSearch::First(const NearSweep& ranking) { return Search(ranking); }

ObstacleSearch::Way ObstacleSearch::WayOverMap(const Eigen::Vector2d& from,
                                               const Eigen::Vector2d& to, double radius) const {
  const double length = (to - from).norm();
  Way way{0, length};
  if (unknown_ == UnknownPolicy::kBlocked) return way;
  const TileBox& box = bounds_.box();
  if (box.IsEmpty()) return {0, -1};
  const double reach = radius + kTouching;
  const Eigen::Vector2d low = Tile::kSide * Eigen::Vector2d(box.tx0, box.ty0);
  const Eigen::Vector2d high = Tile::kSide * Eigen::Vector2d(box.tx1, box.ty1);
  for (int axis = 0; axis < 2; ++axis) {
    const double step = to[axis] - from[axis];
    if (step == 0) {
      if (from[axis] < low[axis] - reach || from[axis] > high[axis] + reach) return {0, -1};
      continue;
    }
    const double a = (low[axis] - reach - from[axis]) / step * length;
    const double b = (high[axis] + reach - from[axis]) / step * length;
    way.begin = std::max(way.begin, std::min(a, b));
    way.end = std::min(way.end, std::max(a, b));
  }
  return way;
}

void ObstacleSearch::Push(Item item) {
  if (item.rank == kInfinity) return;
  heap_.push_back(item);
  std::push_heap(heap_.begin(), heap_.end());
}

template <typename Ranking>
ObstacleSearch::Found ObstacleSearch::Search(const Ranking& ranking) {
  heap_.clear();
  nets_.clear();
  is_certified_ = true;
  const Eigen::Vector2d low = ranking.low();
  const Eigen::Vector2d high = ranking.high();
  if (unknown_ == UnknownPolicy::kBlocked && !IsOnMap(low, high)) {
    return {Occupancy::kUnknown, true, 0, {(low + high) / 2, 0}};
  }
  TileBox tiles{TileIndex(low.x()), TileIndex(low.y()), TileIndex(high.x()) + 1,
                TileIndex(high.y()) + 1};
  if (unknown_ == UnknownPolicy::kFree) {
    const TileBox& box = bounds_.box();
    tiles = {std::max(tiles.tx0, box.tx0), std::max(tiles.ty0, box.ty0),
             std::min(tiles.tx1, box.tx1), std::min(tiles.ty1, box.ty1)};
  }
  for (int32_t ty = tiles.ty0; ty < tiles.ty1; ++ty) {
    for (int32_t tx = tiles.tx0; tx < tiles.tx1; ++tx) AddTile(ranking, {tx, ty});
  }
  while (!heap_.empty()) {
    std::pop_heap(heap_.begin(), heap_.end());
    const Item item = heap_.back();
    heap_.pop_back();
    if (item.kind == Kind::kUnknown) {
      return {Occupancy::kUnknown, is_certified_, item.rank, item.square};
    }
    if (item.kind == Kind::kOccupied) {
      return {Occupancy::kOccupied, is_certified_, item.rank, item.square};
    }
    if (item.kind == Kind::kBlock) {
      OpenBlock(ranking, item.square);
      continue;
    }
    if (item.kind == Kind::kCell) {
      OpenCell(ranking, item.square);
      continue;
    }
    is_certified_ = false;
    const double half = item.square.side / 2;
    if (item.square.side <= kFinestSide) {
      return {Occupancy::kOccupied, false, item.rank, item.square};
    }
    const BezierNet net = nets_[item.net];
    for (const bool upper : {false, true}) {
      for (const bool right : {false, true}) {
        const Eigen::Vector2d corner(right ? half : 0, upper ? half : 0);
        AddSurface(ranking, net.Quarter(right, upper), {item.square.low + corner, half});
      }
    }
  }
  return {Occupancy::kFree, is_certified_, 0, {}};
}

template <typename Ranking>
void ObstacleSearch::AddTile(const Ranking& ranking, TileKey key) {
  const Eigen::Vector2d low = Tile::kSide * Eigen::Vector2d(key.tx, key.ty);
  const TileBounds* tile = bounds_.Find(key);
  if (tile == nullptr) {
    if (unknown_ == UnknownPolicy::kFree) return;
    const SearchSquare square{low, Tile::kSide};
    Push({ranking.Rank(square), Kind::kUnknown, square, 0});
    return;
  }
  if (IsClear(tile->whole)) return;
  for (int k = 0; k < TileBounds::kBlocks * TileBounds::kBlocks; ++k) {
    if (IsClear(tile->blocks[k])) continue;
    constexpr int kSide = TileBounds::kBlockSide;
    const Eigen::Vector2d corner(k % TileBounds::kBlocks, k / TileBounds::kBlocks);
    const SearchSquare square{low + kSide * corner, kSide};
    Push({ranking.Rank(square), Kind::kBlock, square, 0});
  }
}

template <typename Ranking>
void ObstacleSearch::OpenBlock(const Ranking& ranking, const SearchSquare& block) {
  const auto i = static_cast<int32_t>(block.low.x());
  const auto j = static_cast<int32_t>(block.low.y());
  const TileBounds& tile = *bounds_.Find(TileOf(i, j));
  for (int dj = 0; dj < TileBounds::kBlockSide; ++dj) {
    const int row = (j & (Tile::kSide - 1)) + dj;
    uint32_t cells = threshold_ < 0 ? ~uint32_t{0} : tile.positive[row];
    if (unknown_ == UnknownPolicy::kBlocked) cells |= tile.unknown[row];
    cells = cells >> (i & (Tile::kSide - 1)) & ((1 << TileBounds::kBlockSide) - 1);
    for (; cells != 0; cells &= cells - 1) {
      const SearchSquare cell{block.low + Eigen::Vector2d(std::countr_zero(cells), dj), 1};
      Push({ranking.Rank(cell), Kind::kCell, cell, 0});
    }
  }
}

template <typename Ranking>
void ObstacleSearch::OpenCell(const Ranking& ranking, const SearchSquare& cell) {
  const CellPatch patch =
      patches_.Read(static_cast<int32_t>(cell.low.x()), static_cast<int32_t>(cell.low.y()));
  const Bounds bounds = patch.bounds();
  if (IsClear(bounds)) return;
  const double rank = ranking.Rank(cell);
  if (bounds.all_known) {
    if (bounds.lower >= threshold_) {
      Push({rank, Kind::kOccupied, cell, 0});
    } else {
      AddSurface(ranking, BezierNet::OfCell(patch), cell);
    }
    return;
  }
  for (int y = 0; y < 2; ++y) {
    for (int x = 0; x < 2; ++x) {
      const SearchSquare quarter{cell.low + Eigen::Vector2d(0.5 * x, 0.5 * y), 0.5};
      if (!patch.IsKnown(x, y)) {
        if (unknown_ == UnknownPolicy::kBlocked) {
          Push({ranking.Rank(quarter), Kind::kUnknown, quarter, 0});
        }
      } else if (bounds.lower >= threshold_) {
        Push({ranking.Rank(quarter), Kind::kOccupied, quarter, 0});
      } else if (bounds.upper >= threshold_) {
        AddSurface(ranking, BezierNet::OfCell(patch).Quarter(x == 1, y == 1), quarter);
      }
    }
  }
}

template <typename Ranking>
void ObstacleSearch::AddSurface(const Ranking& ranking, const BezierNet& net,
                                const SearchSquare& square) {
  double rank = ranking.Rank(square);
  if (rank == kInfinity) return;
  if (net.Greatest() < threshold_) {
    is_certified_ = false;  // it was the surface that said so, not the control points
    return;
  }
  if (net.Least() >= threshold_) {
    Push({rank, Kind::kOccupied, square, 0});
    return;
  }
  const HalfPlane occupied = OccupiedPart(net, square, threshold_);
  const double rank_of_part = ranking.Rank(occupied);
  if (rank_of_part > rank) {
    rank = rank_of_part;
    if (rank == kInfinity || !ranking.Touches(square, rank)) {
      is_certified_ = false;
      return;
    }
  }
  Push({rank, Kind::kSurface, square, static_cast<int>(nets_.size())});
  nets_.push_back(net);
}

}  // namespace splinemap
