#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <limits>
#include <vector>

#include "lib/query/bezier_net.h"
#include "lib/query/cell_patch.h"
#include "lib/query/surface_bounds.h"
#include "splinemap/map_view.h"
#include "splinemap/queries.h"

namespace splinemap {

// A square of the map frame in knot intervals.
struct SearchSquare {
  Eigen::Vector2d low;
  double side = 0;

  Eigen::Vector2d NearestTo(const Eigen::Vector2d& point) const {
    return point.cwiseMax(low).cwiseMin(low + Eigen::Vector2d::Constant(side));
  }
};

// All points q with normal . q >= offset, in knot intervals; the normal has length 1.
struct HalfPlane {
  Eigen::Vector2d normal;
  double offset;
};

// Squares and half-planes at the distance from a point; those beyond `max` do not count.
struct NearPoint {
  Eigen::Vector2d point;
  double max;

  Eigen::Vector2d low() const { return point - Eigen::Vector2d::Constant(max); }
  Eigen::Vector2d high() const { return point + Eigen::Vector2d::Constant(max); }
  double Rank(const SearchSquare& square) const {
    const double distance = (square.NearestTo(point) - point).norm();
    return distance <= max ? distance : std::numeric_limits<double>::infinity();
  }
  bool Touches(const SearchSquare&, double /*rank*/) const { return true; }
  double Rank(const HalfPlane& half) const {
    const double distance = half.offset - half.normal.dot(point);
    return distance <= max ? std::max(distance, 0.0) : std::numeric_limits<double>::infinity();
  }
};

// Squares and half-planes at how far from `from` the centre of a disc has gone on its way to `to`
// when it touches them; those that it never touches do not count.
struct NearSweep {
  Eigen::Vector2d from;
  Eigen::Vector2d to;
  double radius;

  Eigen::Vector2d low() const { return from.cwiseMin(to) - Eigen::Vector2d::Constant(radius); }
  Eigen::Vector2d high() const { return from.cwiseMax(to) + Eigen::Vector2d::Constant(radius); }
  double Rank(const SearchSquare& square) const;
  double Rank(const HalfPlane& half) const;
  // Whether the disc touches the square when it has gone so far.
  bool Touches(const SearchSquare& square, double gone) const;
};

// Finds the square of least rank, of all that a map has, with a point that is occupied, or unknown
// where that stops: best first, from tiles down to 1/32 knot interval, leaving out what its bounds
// say is free. Thread-compatible; outlived by what it was made of.
class ObstacleSearch {
 public:
  static constexpr double kFinestSide = 1.0 / 32;

  struct Found {
    Occupancy occupancy = Occupancy::kFree;
    bool is_certified = true;  // as in SweepsQuery::Result
    double rank = 0;
    SearchSquare square;
  };

  ObstacleSearch(const SurfaceBounds& bounds, double occupied_log_odds, UnknownPolicy unknown);

  Found Nearest(const NearPoint& ranking);
  Found First(const NearSweep& ranking);

  // The part of a way in which a disc may find something, in knot intervals from its beginning:
  // all of it where unknown stops. Empty where end < begin.
  struct Way {
    double begin = 0;
    double end = 0;
  };
  Way WayOverMap(const Eigen::Vector2d& from, const Eigen::Vector2d& to, double radius) const;

 private:
  enum class Kind : int8_t {
    kBlock,  // to be looked at more closely
    kCell,
    kSurface,   // known, and `net` is not below the threshold everywhere
    kOccupied,  // all of it
    kUnknown
  };
  struct Item {
    double rank;
    Kind kind;
    SearchSquare square;
    int net;                                                               // of kSurface, in nets_
    bool operator<(const Item& other) const { return rank > other.rank; }  // the least on top
  };

  bool IsClear(const Bounds& bounds) const {
    return bounds.upper < threshold_ && (bounds.all_known || unknown_ == UnknownPolicy::kFree);
  }
  void Push(Item item);
  template <typename Ranking>
  Found Search(const Ranking& ranking);
  template <typename Ranking>
  void AddTile(const Ranking& ranking, TileKey key);
  template <typename Ranking>
  void OpenBlock(const Ranking& ranking, const SearchSquare& block);
  template <typename Ranking>
  void OpenCell(const Ranking& ranking, const SearchSquare& cell);
  template <typename Ranking>
  void AddSurface(const Ranking& ranking, const BezierNet& net, const SearchSquare& square);

  const double threshold_;  // in units of control points
  const UnknownPolicy unknown_;
  BoundsReader bounds_;
  PatchReader patches_;
  std::vector<Item> heap_;
  std::vector<BezierNet> nets_;
  bool is_certified_ = true;
};

}  // namespace splinemap
