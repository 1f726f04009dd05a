#pragma once

#include <Eigen/Core>
#include <cstddef>

#include "lib/matching/map_sketch.h"
#include "splinemap/map_view.h"
#include "splinemap/pose2.h"

namespace splinemap {

// How the faces of two maps lie to each other, in metres: the mean of those of each map beside the
// other one.
struct Agreement {
  // What contradicts outweighs so many times as much that agrees.
  static constexpr double kContradictionWeight = 2;

  double agree_m = 0;       // the other map has the face, too
  double contradict_m = 0;  // it has free space there, before and behind
  // Sum over the walls that agree: of their lengths times n n^T, n the normal in the frame of map
  // a; their middle in that frame.
  Eigen::Matrix2d directions_m = Eigen::Matrix2d::Zero();
  Eigen::Vector2d middle_m = Eigen::Vector2d::Zero();

  double score_m() const { return agree_m - kContradictionWeight * contradict_m; }
};

// Two maps, and their sketches of one scale. All four must outlive it.
struct MapPair {
  const MapView& map_a;
  const MapView& map_b;
  const MapSketch& a;
  const MapSketch& b;
  MatchScale scale;
};

// Looks at some `most` points of each map.
Agreement Compare(const MapPair& pair, const Pose2& a_T_b, size_t most);

// Metres of wall that agree beside the two straight lines, across each other, that have most of
// them: what agrees along two lines alone is one corner, and such a corner is everywhere.
double AgreementBesideCorner(const MapPair& pair, const Pose2& a_T_b);

// Turns and shifts b by some MatchScale::Reach() at most until its faces lie on those of a. Looks
// at some `most` points.
Pose2 Pull(const MapPair& pair, const Pose2& a_T_b, size_t most);

// The least squares of the distances of each map's faces from the level 0 of the other's surface.
struct SurfaceFit {
  Pose2 a_T_b;
  double residual_m = 0;  // root of their mean square
  // Of x_m, y_m and yaw_rad of a_T_b. Distances along three times MatchScale::Reach() of wall count
  // as one, since they err alike: maps are warped.
  Eigen::Matrix3d covariance = Eigen::Matrix3d::Zero();
};
// Begins from within a knot interval. Where too little is near, all stays as it was.
SurfaceFit FitSurfaces(const MapPair& pair, const Pose2& a_T_b);

}  // namespace splinemap
