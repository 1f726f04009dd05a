#include "lib/matching/wall_fit.h"

#include <Eigen/Cholesky>
#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <map>
#include <numbers>
#include <utility>
#include <vector>

#include "lib/geometry/angle.h"

namespace splinemap {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector2d;
using Eigen::Vector3d;

// Faces whose normals are further apart, by the cosine, are different ones.
constexpr double kSameDirection = 0.8;

// A transform with its sine and cosine at hand.
class Placement {
 public:
  explicit Placement(const Pose2& pose)
      : position_m_(pose.position_m), x_axis_(UnitVector(pose.yaw_rad)) {}

  Vector2d Rotate(const Vector2d& v) const {
    return {x_axis_.x() * v.x() - x_axis_.y() * v.y(), x_axis_.y() * v.x() + x_axis_.x() * v.y()};
  }
  Vector2d operator*(const Vector2d& point_m) const { return position_m_ + Rotate(point_m); }

 private:
  Vector2d position_m_;
  Vector2d x_axis_;
};

size_t StrideFor(const MapSketch& sketch, size_t most) {
  return std::max<size_t>(1, sketch.walls().size() / most);
}

bool Agrees(const MapSketch& to, const Vector2d& point_m, const Vector2d& normal,
            const MatchScale& scale) {
  const MapSketch::Vertex& vertex = to.At(point_m);
  if (vertex.wall == MapSketch::Vertex::kNone) return false;
  const WallPoint& other = to.walls()[vertex.wall];
  return (other.point_m - point_m).squaredNorm() <= scale.Same() * scale.Same() &&
         other.normal.dot(normal) >= kSameDirection;
}

// The walls of `from` beside `to`. Directions and middle in the frame of `from`; the middle is a
// sum.
Agreement CompareOneWay(const MapSketch& to, const MapSketch& from, const Pose2& to_T_from,
                        const MatchScale& scale, size_t most) {
  const Placement place(to_T_from);
  const size_t stride = StrideFor(from, most);
  Agreement sum;
  for (size_t k = 0; k < from.walls().size(); k += stride) {
    const WallPoint& wall = from.walls()[k];
    const Vector2d point_m = place * wall.point_m;
    const double length_m = static_cast<double>(stride) * wall.length_m;
    if (to.At(point_m).is_open) {
      const Vector2d behind_m = place * (wall.point_m + scale.Behind() * wall.normal);
      if (to.At(behind_m).is_free) sum.contradict_m += length_m;
    }
    if (!Agrees(to, point_m, place.Rotate(wall.normal), scale)) continue;
    sum.agree_m += length_m;
    sum.directions_m += length_m * wall.normal * wall.normal.transpose();
    sum.middle_m += length_m * wall.point_m;
  }
  return sum;
}

double LengthOf(const std::vector<WallPoint>& walls) {
  double length_m = 0;
  for (const WallPoint& wall : walls) length_m += wall.length_m;
  return length_m;
}

// Takes the walls out that lie along the line which has most of them, of those for which
// `may_be_line`; both faces of it. The direction of its normal; zero where there is none.
template <typename F>
Vector2d TakeLine(std::vector<WallPoint>& walls, const MatchScale& scale, F may_be_line) {
  constexpr int kDirections = 36;   // of half a turn
  constexpr double kAlong = 0.985;  // cosine
  const double beside_m = 3 * scale.Same();
  // Of each direction, by the distance from the origin.
  std::map<std::pair<int, int64_t>, double> lengths_m;
  const auto line_of = [&](const WallPoint& wall) {
    const double angle_rad = AngleOf(wall.normal.x(), wall.normal.y());
    const auto turns = static_cast<int>(RoundToInt(angle_rad * kDirections / std::numbers::pi));
    const int direction = ((turns % kDirections) + kDirections) % kDirections;
    const Vector2d normal = UnitVector(std::numbers::pi * direction / kDirections);
    return std::pair(direction, RoundToInt(normal.dot(wall.point_m) / beside_m));
  };
  for (const WallPoint& wall : walls) {
    if (may_be_line(wall.normal)) lengths_m[line_of(wall)] += wall.length_m;
  }
  const auto most =
      std::max_element(lengths_m.begin(), lengths_m.end(),
                       [](const auto& p, const auto& q) { return p.second < q.second; });
  if (most == lengths_m.end()) return Vector2d::Zero();
  const Vector2d normal = UnitVector(std::numbers::pi * most->first.first / kDirections);
  // The walls themselves say where the line is.
  Vector2d direction = Vector2d::Zero();
  Vector2d middle_m = Vector2d::Zero();
  for (const WallPoint& wall : walls) {
    if (line_of(wall) != most->first) continue;
    direction += wall.length_m * (wall.normal.dot(normal) < 0 ? -wall.normal : wall.normal);
    middle_m += wall.length_m / most->second * wall.point_m;
  }
  direction.normalize();
  std::erase_if(walls, [&](const WallPoint& wall) {
    return std::abs(direction.dot(wall.normal)) > kAlong &&
           std::abs(direction.dot(wall.point_m - middle_m)) < beside_m;
  });
  return direction;
}

// A distance along a normal, in the frame of a, at a point there: how far b has to go back.
struct Gap {
  Vector2d point_m;
  Vector2d normal;
  double distance_m;
  double weight;  // metres
};

// Sums of gaps, about their middle: shifts and a turn.
struct NormalEquations {
  Vector2d middle_m = Vector2d::Zero();
  double weight = 0;
  Matrix3d hessian = Matrix3d::Zero();
  Vector3d gradient = Vector3d::Zero();
  double squares = 0;

  explicit NormalEquations(const std::vector<Gap>& gaps) {
    for (const Gap& gap : gaps) {
      middle_m += gap.weight * gap.point_m;
      weight += gap.weight;
    }
    if (weight == 0) return;
    middle_m /= weight;
    for (const Gap& gap : gaps) {
      const Vector2d arm = gap.point_m - middle_m;
      const Vector3d row(gap.normal.x(), gap.normal.y(),
                         gap.normal.y() * arm.x() - gap.normal.x() * arm.y());
      hessian += gap.weight * row * row.transpose();
      gradient += gap.weight * gap.distance_m * row;
      squares += gap.weight * gap.distance_m * gap.distance_m;
    }
  }

  // By Gauss and Newton, damped by a share of the weight.
  Vector3d Step(double damping) const {
    const Matrix3d damped = hessian + Matrix3d(Vector3d::Constant(damping * weight).asDiagonal());
    return -damped.ldlt().solve(gradient);
  }
  Pose2 Apply(const Vector3d& step, const Pose2& a_T_b) const {
    const Placement turn({Vector2d::Zero(), step.z()});
    return {middle_m + step.head<2>() + turn.Rotate(a_T_b.position_m - middle_m),
            WrapAngle(a_T_b.yaw_rad + step.z())};
  }
};

// Of what is further than `reach` nothing is left.
double Tukey(double distance, double reach) {
  const double share = 1 - distance * distance / (reach * reach);
  return share > 0 ? share * share : 0;
}

std::vector<Gap> GapsToWalls(const MapPair& pair, const Pose2& a_T_b, double reach_m,
                             size_t stride) {
  constexpr double kAcross = 0.5;  // cosine
  const Placement place(a_T_b);
  std::vector<Gap> gaps;
  for (size_t k = 0; k < pair.b.walls().size(); k += stride) {
    const WallPoint& wall = pair.b.walls()[k];
    const Vector2d point_m = place * wall.point_m;
    const MapSketch::Vertex& vertex = pair.a.At(point_m);
    if (vertex.wall == MapSketch::Vertex::kNone) continue;
    const WallPoint& other = pair.a.walls()[vertex.wall];
    const double likeness = other.normal.dot(place.Rotate(wall.normal));
    const Vector2d to_point_m = point_m - other.point_m;
    const double weight = likeness * Tukey(to_point_m.norm(), reach_m);
    if (likeness < kAcross || weight == 0) continue;
    gaps.push_back({point_m, other.normal, other.normal.dot(to_point_m), wall.length_m * weight});
  }
  return gaps;
}

// From the faces of `from` to the level 0 of `map`; in the frame of `from` if `back`, where the
// gap is what `to` has to go.
void AddGapsToSurface(const MapView& map, const MapSketch& to, const MapSketch& from,
                      const Pose2& to_T_from, const MatchScale& scale, bool back,
                      std::vector<Gap>& gaps) {
  const Placement place(to_T_from);
  std::vector<Vector2d> points_m;
  std::vector<const WallPoint*> walls;
  for (const WallPoint& wall : from.walls()) {
    const Vector2d point_m = place * wall.point_m;
    const MapSketch::Vertex& vertex = to.At(point_m);
    if (vertex.wall == MapSketch::Vertex::kNone) continue;
    const WallPoint& other = to.walls()[vertex.wall];
    if (other.normal.dot(place.Rotate(wall.normal)) < kSameDirection) continue;
    points_m.push_back(point_m);
    walls.push_back(&wall);
  }
  std::vector<SurfaceSample> samples(points_m.size());
  map.EvaluateMany(points_m, absl::MakeSpan(samples));
  const Placement turn_back(Inverse(to_T_from));
  for (size_t k = 0; k < samples.size(); ++k) {
    const double slope = samples[k].gradient_per_m.norm();
    if (slope * map.options.knot_interval_m < kLeastFaceSlope) continue;
    const double distance_m = samples[k].log_odds / slope;
    const double weight = walls[k]->length_m * Tukey(distance_m, scale.Same());
    if (weight == 0) continue;
    const Vector2d normal = samples[k].gradient_per_m / slope;
    if (back) {
      gaps.push_back({walls[k]->point_m, turn_back.Rotate(normal), -distance_m, weight});
    } else {
      gaps.push_back({points_m[k], normal, distance_m, weight});
    }
  }
}

std::vector<Gap> GapsToSurfaces(const MapPair& pair, const Pose2& a_T_b) {
  std::vector<Gap> gaps;
  AddGapsToSurface(pair.map_a, pair.a, pair.b, a_T_b, pair.scale, false, gaps);
  AddGapsToSurface(pair.map_b, pair.b, pair.a, Inverse(a_T_b), pair.scale, true, gaps);
  return gaps;
}

}  // namespace

Agreement Compare(const MapPair& pair, const Pose2& a_T_b, size_t most) {
  const Agreement of_a = CompareOneWay(pair.b, pair.a, Inverse(a_T_b), pair.scale, most);
  const Agreement of_b = CompareOneWay(pair.a, pair.b, a_T_b, pair.scale, most);
  Agreement mean;
  mean.agree_m = (of_a.agree_m + of_b.agree_m) / 2;
  mean.contradict_m = (of_a.contradict_m + of_b.contradict_m) / 2;
  mean.directions_m = of_a.directions_m;
  if (of_a.agree_m > 0) mean.middle_m = of_a.middle_m / of_a.agree_m;
  return mean;
}

double AgreementBesideCorner(const MapPair& pair, const Pose2& a_T_b) {
  constexpr double kAcross = 0.7;  // cosine
  const Pose2 b_T_a = Inverse(a_T_b);
  const Placement place(b_T_a);
  std::vector<WallPoint> walls;
  for (const WallPoint& wall : pair.a.walls()) {
    if (Agrees(pair.b, place * wall.point_m, place.Rotate(wall.normal), pair.scale)) {
      walls.push_back(wall);
    }
  }
  const Vector2d first = TakeLine(walls, pair.scale, [](const Vector2d&) { return true; });
  TakeLine(walls, pair.scale,
           [&](const Vector2d& normal) { return std::abs(normal.dot(first)) < kAcross; });
  return LengthOf(walls);
}

Pose2 Pull(const MapPair& pair, const Pose2& a_T_b, size_t most) {
  constexpr size_t kLeastGaps = 10;
  constexpr double kDamping = 0.02;
  const size_t stride = StrideFor(pair.b, most);
  Pose2 pose = a_T_b;
  for (const double share : {1.0, 1.0, 0.8, 0.8, 0.6, 0.5, 0.4, 0.3, 0.3, 0.3}) {
    const std::vector<Gap> gaps = GapsToWalls(pair, pose, share * pair.scale.Reach(), stride);
    if (gaps.size() < kLeastGaps) return pose;
    const NormalEquations equations(gaps);
    pose = equations.Apply(equations.Step(kDamping), pose);
  }
  return pose;
}

SurfaceFit FitSurfaces(const MapPair& pair, const Pose2& a_T_b) {
  constexpr int kMostSteps = 20;
  constexpr double kDamping = 1e-6;
  constexpr double kStill = 1e-6;  // m and rad
  SurfaceFit fit{a_T_b};
  for (int n = 0; n < kMostSteps; ++n) {
    const NormalEquations equations(GapsToSurfaces(pair, fit.a_T_b));
    if (equations.weight == 0) return fit;
    const Vector3d step = equations.Step(kDamping);
    fit.a_T_b = equations.Apply(step, fit.a_T_b);
    if (step.norm() < kStill) break;
  }
  const NormalEquations equations(GapsToSurfaces(pair, fit.a_T_b));
  if (equations.weight == 0) return fit;
  // Maps of one drive agree to the bit, and are not surer for it.
  constexpr double kLeastResidual = 0.02;  // knot intervals
  fit.residual_m =
      std::max(std::sqrt(equations.squares / equations.weight), kLeastResidual * pair.scale.knot_m);
  // Each wall was counted in both maps.
  const double independent = 1 / (2 * 3 * pair.scale.Reach());
  const Matrix3d information =
      independent *
      (equations.hessian + Matrix3d(Vector3d::Constant(kDamping * equations.weight).asDiagonal()));
  // From shifts and turns about the middle to those of the pose.
  const Vector2d arm = fit.a_T_b.position_m - equations.middle_m;
  Matrix3d of_pose = Matrix3d::Identity();
  of_pose(0, 2) = -arm.y();
  of_pose(1, 2) = arm.x();
  fit.covariance =
      fit.residual_m * fit.residual_m * of_pose * information.inverse() * of_pose.transpose();
  return fit;
}

}  // namespace splinemap
