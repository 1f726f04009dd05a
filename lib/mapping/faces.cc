#include "lib/mapping/faces.h"

#include <algorithm>
#include <cmath>

namespace splinemap {
namespace {

using Eigen::Vector2d;

// Neighbours lie on one surface if they are no further apart than this, or than this many times the
// distance between their beams.
constexpr double kNearKnots = 3;
constexpr double kMostObliqueGap = 4;
// The normal is that of a chord to hits so far on either side, or so many.
constexpr double kHalfChordKnots = 2;
constexpr size_t kMostBeamsAside = 8;
constexpr double kLeastChordKnots = 1;
// Beyond 72 degrees of incidence faces are treated as of that.
constexpr double kLeastCosine = 0.3;
// Rows of control points from so far before a face take part in it, seen head-on.
constexpr double kBefore = SignedDistance::kFrontKnots + 1;
// Rows of control points up to so far behind the face take part in it: one at least that lies half
// a knot behind. Of what is narrow more, since beams that pass it take them away again.
constexpr double kBehindKnots = 1.5;
constexpr double kBehindNarrowKnots = 1.75;
// Things narrower than that weigh more.
constexpr double kWideKnots = 6;

double Cross(const Vector2d& a, const Vector2d& b) { return a.x() * b.y() - a.y() * b.x(); }

}  // namespace

absl::Span<const Face> FaceFinder::Find(absl::Span<const PlacedBeam> beams) {
  hits_.resize(beams.size());
  spacings_.resize(beams.size());
  faces_.resize(beams.size());
  for (size_t k = 0; k < beams.size(); ++k) {
    const PlacedBeam& beam = beams[k];
    const double range = beam.range_m * knots_per_m_;
    hits_[k] = beam.origin_world_m * knots_per_m_ + range * beam.direction_world;
    const size_t next = k + 1 < beams.size() ? k + 1 : k > 0 ? k - 1 : k;
    spacings_[k] = range * std::abs(Cross(beam.direction_world, beams[next].direction_world));
  }
  for (size_t k = 0; k < beams.size();) {
    if (!beams[k].hit) {
      faces_[k++] = {};
      continue;
    }
    const Run run = RunFrom(beams, k);
    const int weight = WeightOf(beams, run);
    for (; k < run.end; ++k) faces_[k] = FaceOf(beams[k], run, k, weight);
  }
  return faces_;
}

// The run that begins with a hit.
FaceFinder::Run FaceFinder::RunFrom(absl::Span<const PlacedBeam> beams, size_t begin) const {
  size_t end = begin + 1;
  for (; end < beams.size() && beams[end].hit; ++end) {
    const double gap = std::max(kMostObliqueGap * spacings_[end - 1], kNearKnots);
    if ((hits_[end] - hits_[end - 1]).squaredNorm() >= gap * gap) break;
  }
  return {begin, end};
}

int FaceFinder::WeightOf(absl::Span<const PlacedBeam> beams, const Run& run) const {
  // Where something hides a part of the surface, or the scan ends, its width is not known.
  if (run.begin == 0 || run.end == beams.size()) return kFaceWeight;
  if (beams[run.begin - 1].range_m <= beams[run.begin].range_m ||
      beams[run.end].range_m <= beams[run.end - 1].range_m) {
    return kFaceWeight;
  }
  const double width = (hits_[run.begin] - hits_[run.end - 1]).norm() + spacings_[run.begin];
  const double weight = kFaceWeight * kWideKnots / std::max(width, 0.1);
  return static_cast<int>(std::clamp<double>(weight, kFaceWeight, kMostFaceWeight));
}

Face FaceFinder::FaceOf(const PlacedBeam& beam, const Run& run, size_t k, int weight) const {
  const double behind = weight > kFaceWeight ? kBehindNarrowKnots : kBehindKnots;
  size_t aside = kMostBeamsAside;
  if (spacings_[k] * kMostBeamsAside > kHalfChordKnots) {
    aside = static_cast<size_t>(kHalfChordKnots / spacings_[k]) + 1;
  }
  const Vector2d chord = hits_[std::min(k + aside, run.end - 1)] -
                         hits_[k - run.begin > aside ? k - aside : run.begin];
  const double squared_length = chord.squaredNorm();
  const Vector2d& direction = beam.direction_world;
  if (squared_length < kLeastChordKnots * kLeastChordKnots) {
    return {{direction.x(), direction.y()}, kBefore, behind, weight};
  }
  const double scale = 1 / std::sqrt(squared_length);
  Vector2d normal(-chord.y() * scale, chord.x() * scale);
  double cosine = normal.dot(direction);
  if (cosine < 0) {
    normal = -normal;
    cosine = -cosine;
  }
  const double stretch = 1 / std::max(cosine, kLeastCosine);
  return {{normal.x(), normal.y()}, (kBefore - 1) * stretch + 1, behind, weight};
}

}  // namespace splinemap
