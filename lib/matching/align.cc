#include "lib/matching/align.h"

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>
#include <string>
#include <vector>

#include "lib/base/status.h"
#include "lib/geometry/angle.h"
#include "lib/matching/map_sketch.h"
#include "lib/matching/pose_search.h"
#include "lib/matching/wall_fit.h"

namespace splinemap {
namespace {

using Eigen::Vector2d;

constexpr double kDegree = std::numbers::pi / 180;

// Share of all that agrees or contradicts.
constexpr double kMostContradicted = 0.25;
// Metres of wall that have to hold the maps in each direction, and that have to agree beside the
// two lines of a corner.
constexpr double kLeastHold_m = 2.5;
constexpr double kLeastBesideCorner_m = 5;
// A place fits as well that has so much of the best score, or less of it and contradicts hardly
// more: in a row of equal rooms the right place may be one where fewer of them overlap.
constexpr double kAlike = 0.7;
constexpr double kAlikeInPart = 0.5;
constexpr double kHardlyMore = 0.03;
// Maps of knots that differ more are not compared.
constexpr double kMostKnotRatio = 10;
// Poses that are closer are one place: knot intervals, radians.
constexpr double kOtherPlace = 10;
constexpr double kOtherHeading_rad = 5 * kDegree;

// Points of each map that are looked at: to pull, to compare candidates, to judge.
constexpr size_t kPull = 600;
constexpr size_t kCompare = 1500;
constexpr size_t kAll = std::numeric_limits<size_t>::max();

struct Place {
  Pose2 a_T_b;
  Agreement agreement;

  double score_m() const { return agreement.score_m(); }
};

struct Match {
  Alignment alignment;
  // The shift that the walls which agree hold least: where to, in the frame of a, and how many
  // metres of wall stand across it.
  double slide_rad = 0;
  double hold_m = 0;
  double beside_corner_m = 0;  // see AgreementBesideCorner()
};

std::string TextOf(const Pose2& pose) {
  return fmt::format("x {:.2f} m, y {:.2f} m, yaw {:.1f} degrees", pose.position_m.x(),
                     pose.position_m.y(), pose.yaw_rad / kDegree);
}

Place PulledFrom(const MapPair& pair, const Pose2& a_T_b) {
  const Pose2 pulled = Pull(pair, a_T_b, kPull);
  return {pulled, Compare(pair, pulled, kCompare)};
}

Place FittedFrom(const MapPair& pair, const Pose2& a_T_b, SurfaceFit& fit) {
  fit = FitSurfaces(pair, a_T_b);
  return {fit.a_T_b, Compare(pair, fit.a_T_b, kAll)};
}

void SortByScore(std::vector<Place>& places) {
  std::stable_sort(places.begin(), places.end(),
                   [](const Place& p, const Place& q) { return p.score_m() > q.score_m(); });
}

void SetSlide(const Agreement& agreement, Match& match) {
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix2d> solver(agreement.directions_m);
  match.hold_m = std::max(solver.eigenvalues()(0), 0.0);
  const Vector2d direction = solver.eigenvectors().col(0);
  match.slide_rad = AngleOf(direction.x(), direction.y());
}

// Whether they put the middle of what agrees elsewhere, or turn it.
bool IsElsewhere(const MapPair& pair, const Place& best, const Pose2& a_T_b) {
  const Vector2d middle_b_m = Inverse(best.a_T_b) * best.agreement.middle_m;
  const double shift_m = (a_T_b * middle_b_m - best.agreement.middle_m).norm();
  return shift_m > kOtherPlace * pair.scale.knot_m ||
         std::abs(WrapAngle(a_T_b.yaw_rad - best.a_T_b.yaw_rad)) > kOtherHeading_rad;
}

std::optional<Alignment::RunnerUp> FindRunnerUp(const MapPair& pair, const Place& best,
                                                double slide_rad, std::vector<Place> places) {
  // What slides may have no other maximum.
  for (const double shift : {-32.0, -22.0, -14.0, 14.0, 22.0, 32.0}) {
    Pose2 shifted = best.a_T_b;
    shifted.position_m += shift * pair.scale.knot_m * UnitVector(slide_rad);
    places.push_back(PulledFrom(pair, shifted));
  }
  SortByScore(places);
  const auto other = std::find_if(places.begin(), places.end(), [&](const Place& place) {
    return IsElsewhere(pair, best, place.a_T_b);
  });
  if (other == places.end()) return std::nullopt;
  SurfaceFit fit;
  const Place fitted = FittedFrom(pair, other->a_T_b, fit);
  if (fitted.score_m() <= 0) return std::nullopt;
  return Alignment::RunnerUp{fitted.a_T_b, fitted.agreement.agree_m, fitted.agreement.contradict_m,
                             fitted.score_m()};
}

double KnownArea(const MapSketch& sketch) {
  size_t known = 0;
  sketch.ForEachKnown([&](const Vector2d&, const MapSketch::Vertex&) { ++known; });
  return static_cast<double>(known) * sketch.knot_m() * sketch.knot_m();
}

void SetOverlap(const MapPair& pair, Alignment& alignment) {
  const Pose2 b_T_a = Inverse(alignment.a_T_b);
  const Vector2d x_axis = UnitVector(b_T_a.yaw_rad);
  size_t known = 0;
  pair.a.ForEachKnown([&](const Vector2d& p, const MapSketch::Vertex&) {
    const Vector2d in_b(x_axis.x() * p.x() - x_axis.y() * p.y(),
                        x_axis.y() * p.x() + x_axis.x() * p.y());
    known += pair.b.At(b_T_a.position_m + in_b).is_known ? 1 : 0;
  });
  alignment.overlap_m2 = static_cast<double>(known) * pair.a.knot_m() * pair.a.knot_m();
  const double less_m2 = std::min(KnownArea(pair.a), KnownArea(pair.b));
  alignment.overlap = std::min(alignment.overlap_m2 / less_m2, 1.0);
}

absl::StatusOr<Match> FindMatch(const MapPair& pair, const AlignOptions& options) {
  SPLINEMAP_ASSIGN_OR_RETURN(const std::vector<Pose2> candidates,
                             SearchPoses(pair, options.on_progress));
  std::vector<Place> places;
  for (const Pose2& candidate : candidates) places.push_back(PulledFrom(pair, candidate));
  SortByScore(places);
  Match match;
  if (places.empty()) return match;
  SurfaceFit fit;
  const Place best = FittedFrom(pair, places.front().a_T_b, fit);
  SetSlide(best.agreement, match);
  match.beside_corner_m = AgreementBesideCorner(pair, best.a_T_b);
  match.alignment = {.a_T_b = fit.a_T_b,
                     .agree_m = best.agreement.agree_m,
                     .contradict_m = best.agreement.contradict_m,
                     .score_m = best.score_m(),
                     .residual_m = fit.residual_m,
                     .covariance = fit.covariance,
                     .runner_up = FindRunnerUp(pair, best, match.slide_rad, std::move(places))};
  SetOverlap(pair, match.alignment);
  return match;
}

// From that of a in b to that of b in a.
Match Inverted(const Match& match) {
  const Alignment& from = match.alignment;
  Match to = match;
  to.alignment.a_T_b = Inverse(from.a_T_b);
  if (from.runner_up) to.alignment.runner_up->a_T_b = Inverse(from.runner_up->a_T_b);
  // Of -R' t by t, and by the angle of R.
  const Vector2d x_axis = UnitVector(to.alignment.a_T_b.yaw_rad);
  Eigen::Matrix3d jacobian;
  jacobian << -x_axis.x(), x_axis.y(), to.alignment.a_T_b.position_m.y(),  //
      -x_axis.y(), -x_axis.x(), -to.alignment.a_T_b.position_m.x(),        //
      0, 0, -1;
  to.alignment.covariance = jacobian * from.covariance * jacobian.transpose();
  to.slide_rad = match.slide_rad + to.alignment.a_T_b.yaw_rad;
  return to;
}

double Contradicted(double agree_m, double contradict_m) {
  return contradict_m / (agree_m + contradict_m);
}

bool IsAlike(const Alignment::RunnerUp& other, const Alignment& found) {
  const double more = Contradicted(other.agree_m, other.contradict_m) -
                      Contradicted(found.agree_m, found.contradict_m);
  return other.score_m > (more <= kHardlyMore ? kAlikeInPart : kAlike) * found.score_m;
}

absl::Status Judge(const Match& match, double least_score_m) {
  constexpr double kNothing_m = 1;
  const Alignment& found = match.alignment;
  if (found.agree_m < kNothing_m) {
    return FailedPrecondition(
        "the maps have too little in common: there is no place at which their walls agree");
  }
  if (found.score_m < least_score_m) {
    return FailedPrecondition(
        "the maps have too little in common: where they fit best ({}) they share {:.0f} m2, "
        "{:.1f} m of walls agree and {:.1f} m contradict; {:.1f} m have to agree beyond twice "
        "what contradicts",
        TextOf(found.a_T_b), found.overlap_m2, found.agree_m, found.contradict_m, least_score_m);
  }
  const double contradicted = Contradicted(found.agree_m, found.contradict_m);
  if (contradicted > kMostContradicted) {
    return FailedPrecondition(
        "the maps contradict each other: where they fit best ({}) {:.1f} m of walls agree and "
        "{:.1f} m contradict, {:.0f} %; {:.0f} % may",
        TextOf(found.a_T_b), found.agree_m, found.contradict_m, 100 * contradicted,
        100 * kMostContradicted);
  }
  if (match.hold_m < kLeastHold_m) {
    const double degrees = WrapAngle(match.slide_rad) / kDegree;
    return FailedPrecondition(
        "the maps fit, but slide along the direction of {:.0f} degrees, as in a corridor: of "
        "{:.1f} m of walls that agree, {:.1f} m stand across it; {:.1f} m have to",
        degrees < 0 ? degrees + 180 : degrees, found.agree_m, match.hold_m, kLeastHold_m);
  }
  if (match.beside_corner_m < kLeastBesideCorner_m) {
    return FailedPrecondition(
        "one corner alone fits, and any other may fit as well: of {:.1f} m of walls that agree, "
        "{:.1f} m are beside its two lines; {:.1f} m have to be",
        found.agree_m, match.beside_corner_m, kLeastBesideCorner_m);
  }
  if (found.runner_up && IsAlike(*found.runner_up, found)) {
    const Alignment::RunnerUp& other = *found.runner_up;
    return FailedPrecondition(
        "two places fit: {} ({:.1f} m of walls agree, {:.1f} m contradict) and {} ({:.1f} m, "
        "{:.1f} m)",
        TextOf(found.a_T_b), found.agree_m, found.contradict_m, TextOf(other.a_T_b), other.agree_m,
        other.contradict_m);
  }
  return absl::OkStatus();
}

absl::StatusOr<MapSketch> SketchOf(const MapView& map, const MatchScale& scale, const char* name) {
  absl::StatusOr<MapSketch> sketch = MapSketch::Of(map, scale);
  if (sketch.ok()) return sketch;
  return FailedPrecondition("map {}: {}", name, ErrorText(sketch.status()));
}

}  // namespace

absl::StatusOr<Alignment> Align(const MapView& a, const MapView& b, const AlignOptions& options) {
  const auto [finer_m, wider_m] = std::minmax(a.options.knot_interval_m, b.options.knot_interval_m);
  if (wider_m > kMostKnotRatio * finer_m) {
    return FailedPrecondition(
        "knot intervals of {} and {} m are too different; make one map anew with splinemap fold "
        "--knot-interval-m",
        finer_m, wider_m);
  }
  const MatchScale scale{wider_m};
  SPLINEMAP_ASSIGN_OR_RETURN(const MapSketch sketch_a, SketchOf(a, scale, "A"));
  SPLINEMAP_ASSIGN_OR_RETURN(const MapSketch sketch_b, SketchOf(b, scale, "B"));
  // The map with less is turned, whichever it is.
  const bool is_exchanged = sketch_b.wall_m() > sketch_a.wall_m();
  const MapPair pair = is_exchanged ? MapPair{b, a, sketch_b, sketch_a, scale}
                                    : MapPair{a, b, sketch_a, sketch_b, scale};
  SPLINEMAP_ASSIGN_OR_RETURN(Match match, FindMatch(pair, options));
  if (is_exchanged) match = Inverted(match);
  Eigen::Matrix3d& covariance = match.alignment.covariance;
  covariance = ((covariance + covariance.transpose()) / 2).eval();  // to the last bit
  SPLINEMAP_RETURN_IF_ERROR(Judge(match, options.min_score_m));
  return match.alignment;
}

}  // namespace splinemap
