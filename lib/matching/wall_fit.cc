#include "lib/matching/wall_fit.h"

#include <Eigen/Cholesky>
#include <Eigen/LU>
#include <algorithm>
#include <cmath>
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
    const MapSketch::Vertex& vertex = to.At(point_m);
    const double length_m = static_cast<double>(stride) * wall.length_m;
    if (vertex.is_open) {
      const Vector2d behind_m = place * (wall.point_m + scale.Behind() * wall.normal);
      if (to.At(behind_m).is_free) sum.contradict_m += length_m;
    }
    if (vertex.wall == MapSketch::Vertex::kNone) continue;
    const WallPoint& other = to.walls()[vertex.wall];
    if ((other.point_m - point_m).squaredNorm() > scale.Same() * scale.Same() ||
        other.normal.dot(place.Rotate(wall.normal)) < kSameDirection) {
      continue;
    }
    sum.agree_m += length_m;
    sum.directions_m += length_m * wall.normal * wall.normal.transpose();
    sum.middle_m += length_m * wall.point_m;
  }
  return sum;
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
  fit.residual_m = std::sqrt(equations.squares / equations.weight);
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
