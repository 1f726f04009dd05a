#pragma once

#include <Eigen/Core>
#include <functional>
#include <optional>

#include "absl/status/statusor.h"
#include "splinemap/map_view.h"
#include "splinemap/pose2.h"

namespace splinemap {

struct AlignOptions {
  // How many metres of wall have to agree, after twice those that contradict were taken off.
  double min_score_m = 15;
  // Is told now and then what share is done.
  std::function<void(double share)> on_progress = [](double) {};
};

// How two maps lie to each other.
struct Alignment {
  Pose2 a_T_b;  // from the frame of b to that of a

  double overlap_m2 = 0;    // of the world, known to both
  double overlap = 0;       // that, as a share of what the map knows that knows less
  double agree_m = 0;       // length of walls that both have; the mean of theirs
  double contradict_m = 0;  // of walls that one has where the other saw free space
  double score_m = 0;       // the first less twice the second
  double residual_m = 0;    // root mean square of the distances of one's walls from the other's

  // Of x_m, y_m and yaw_rad of a_T_b: metres and radians, row-major and symmetric. It says how well
  // walls hold the maps in place, not whether the maps are right.
  Eigen::Matrix3d covariance = Eigen::Matrix3d::Zero();

  // The next best place, more than 10 knot intervals or 5 degrees away; none where nothing agrees
  // anywhere else.
  struct RunnerUp {
    Pose2 a_T_b;
    double agree_m = 0;
    double contradict_m = 0;
    double score_m = 0;
  };
  std::optional<RunnerUp> runner_up{};
};

// Finds where map b lies in the frame of map a, without a guess: all headings, all shifts at which
// walls meet. Their knot intervals may differ by 10 times. The same maps give the same bits, and
// exchanged ones the inverse.
//
// FailedPrecondition, which says why and with which figures, rather than a place that may be wrong:
// too little in common; too much that contradicts; walls in one direction alone, along which the
// maps slide; one corner alone; two places that fit, as in a symmetric room or a row of equal
// rooms; a map without walls or too large.
absl::StatusOr<Alignment> Align(const MapView& a, const MapView& b,
                                const AlignOptions& options = {});

}  // namespace splinemap
