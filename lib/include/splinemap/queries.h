#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <variant>
#include <vector>

#include "absl/status/status.h"
#include "splinemap/pose2.h"
#include "splinemap/surface.h"

// What can be asked about a map, in metres and radians of the map frame, and what the answers are.
// Every answer is of one state of the map: `revision` counts the commits to all layers so far.
// Check() says what no map answers: InvalidArgument with the place in the query.

namespace splinemap {

enum class Occupancy : int8_t { kFree = 0, kOccupied = 1, kUnknown = 2 };

// What rays and sweeps make of points whose nearest control point no measurement touched.
enum class UnknownPolicy : int8_t {
  kBlocked = 0,  // they end there
  kFree = 1,     // it counts as free
};

// Where a surface is occupied: its log-odds are `occupied_log_odds` or more. 0, p >= 1/2, is where
// the faces of things are, in the map of one robot as in the sum of several: within 3 mm in the
// mean for walls seen at up to 70 degrees of incidence, and within 11 mm for doors and for poles of
// 5 cm and more, at knots of 5 cm and 1 cm of noise (lib/mapping/README.md has all of it). Maps of
// the preset `paper` have their faces about 6 cm behind it.
inline constexpr double kDefaultOccupied = 0;

// Value and gradient, and with_hessians the second derivatives. Points that are not finite or off
// the map (kMaxKnotIndex) are not known, and 0.
struct PointsQuery {
  std::vector<Eigen::Vector2d> points_m;
  bool with_hessians = false;

  struct Answer {
    uint64_t revision = 0;
    std::vector<SurfaceSample> samples;
    std::vector<Eigen::Matrix2d> hessians_per_m2;
  };
};

struct Ray {
  Eigen::Vector2d origin_m = Eigen::Vector2d::Zero();
  double bearing_rad = 0;  // counter-clockwise from the x axis
  double max_range_m = 0;
};

// Where rays end: the first point that is occupied, or unknown where that stops them.
struct RaysQuery {
  std::vector<Ray> rays;
  double occupied_log_odds = kDefaultOccupied;
  UnknownPolicy unknown = UnknownPolicy::kBlocked;

  struct End {
    Occupancy occupancy = Occupancy::kFree;
    double range_m = 0;  // max_range_m where free
  };
  struct Answer {
    uint64_t revision = 0;
    std::vector<End> ends;
  };
};

// The rays of a planar scanner at `world_T_sensor`: their ends are the ranges to expect.
std::vector<Ray> RaysOfScan(const Pose2& world_T_sensor, const std::vector<double>& bearings_rad,
                            double max_range_m);

// A disc of `radius_m` whose centre goes along a polyline of one vertex or more.
struct Sweep {
  static constexpr size_t kMaxVertices = 1000;
  static constexpr double kMaxRadius_m = 10;
  static constexpr double kMaxCoordinate_m = 1e10;  // beyond every map; steps stay exact

  std::vector<Eigen::Vector2d> path_m;
  double radius_m = 0;
};

// Whether discs can go along paths.
struct SweepsQuery {
  std::vector<Sweep> sweeps;
  double occupied_log_odds = kDefaultOccupied;
  UnknownPolicy unknown = UnknownPolicy::kBlocked;

  struct Result {
    Occupancy occupancy = Occupancy::kFree;
    // Decided by the least and greatest control points alone, between which the surface lies
    // (equation 4). Else the surface was looked at, to 1/32 knot interval: where it is in doubt
    // whether so small a square is occupied, it is.
    bool is_certified = false;
    double free_m = 0;  // length of path up to the first contact; all of it where free
    // A point of that, to 1/16 knot interval; 0 where free.
    Eigen::Vector2d contact_m = Eigen::Vector2d::Zero();
  };
  struct Answer {
    uint64_t revision = 0;
    std::vector<Result> results;
  };
};

// The surface at first_m + resolution_m * (column, row), rows of `width` from the lowest y up.
struct RasterQuery {
  static constexpr int64_t kMaxCells = int64_t{1} << 28;

  Eigen::Vector2d first_m = Eigen::Vector2d::Zero();
  double resolution_m = 0;
  int32_t width = 0;
  int32_t height = 0;

  struct Answer {
    uint64_t revision = 0;
    // 1/256 log-odds, as ControlPoint: 0 where not known, 1 where it is and would be 0.
    std::vector<int16_t> cells;
  };
};

// Where cell number `cell` is, counted along rows.
Eigen::Vector2d PointOfCell(const RasterQuery& query, size_t cell);
// The cell of which the surface is that.
int16_t CellOf(const SurfaceSample& sample);

// How well a scan fits at many poses: of each the sum over its hits of log p(occupied), where what
// is not known counts as the surface says, log 1/2 far from everything. p is 1/2 on a face and more
// behind it, and so hits of one wall alone fit best a knot interval too far; walls on all sides
// outweigh that. This is the end point model of a range finder: it does not ask whether beams pass
// through walls.
struct LikelihoodsQuery {
  static constexpr size_t kMaxHits = 2000;

  std::vector<Eigen::Vector2d> hits_robot_m;  // in the robot's frame
  std::vector<Pose2> world_T_robot;

  struct Answer {
    uint64_t revision = 0;
    std::vector<double> log_likelihoods;
  };
};

// How far the nearest occupied point is. Never more than that; at most 1/16 knot interval less than
// to the nearest point of log-odds 0.1 below the threshold.
struct DistancesQuery {
  static constexpr double kMaxDistance_m = 100;

  std::vector<Eigen::Vector2d> points_m;
  double max_distance_m = 2;
  double occupied_log_odds = kDefaultOccupied;

  struct Distance {
    double distance_m = 0;  // 0 in obstacles; max_distance_m where nothing is nearer
    // Of the distance: from the nearest occupied point to this one, of length 1; 0 in obstacles and
    // where nothing is near.
    Eigen::Vector2d gradient = Eigen::Vector2d::Zero();
  };
  struct Answer {
    uint64_t revision = 0;
    std::vector<Distance> distances;
  };
};

absl::Status Check(const PointsQuery& query);
absl::Status Check(const RaysQuery& query);
absl::Status Check(const SweepsQuery& query);
absl::Status Check(const RasterQuery& query);
absl::Status Check(const LikelihoodsQuery& query);
absl::Status Check(const DistancesQuery& query);

// All kinds of query: what is done for each of them is done over this list.
template <typename... Queries>
struct QueryList {
  using Any = std::variant<const Queries*...>;
  using AnyAnswer = std::variant<typename Queries::Answer...>;

  // Calls f.template operator()<Query>() for each.
  template <typename F>
  static void ForEach(F f) {
    (f.template operator()<Queries>(), ...);
  }
};
using AllQueries =
    QueryList<PointsQuery, RaysQuery, SweepsQuery, RasterQuery, LikelihoodsQuery, DistancesQuery>;
using AnyQuery = AllQueries::Any;
using AnyAnswer = AllQueries::AnyAnswer;

}  // namespace splinemap
