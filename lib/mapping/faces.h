#pragma once

#include <vector>

#include "absl/types/span.h"
#include "lib/mapping/scan_kernel.h"
#include "splinemap/scan.h"

namespace splinemap {

// Weights of a beam at its face, in units of its weight in free space: what is hit counts more than
// what is passed, and narrow things, which few beams of a scan hit, more than walls.
inline constexpr int kFaceWeight = 48;
inline constexpr int kMostFaceWeight = 240;

// Finds the surface that each beam hits. Keeps its memory from scan to scan. Thread-compatible.
class FaceFinder {
 public:
  explicit FaceFinder(double knots_per_m) : knots_per_m_(knots_per_m) {}

  // One for each beam, valid until the next call, as the hits beside it tell: beams are in order of
  // their bearings. Lone hits face the sensor.
  absl::Span<const Face> Find(absl::Span<const PlacedBeam> beams);

 private:
  // A run of hits on one surface: beams [begin, end).
  struct Run {
    size_t begin;
    size_t end;
  };
  Run RunFrom(absl::Span<const PlacedBeam> beams, size_t begin) const;
  int WeightOf(absl::Span<const PlacedBeam> beams, const Run& run) const;
  Face FaceOf(const PlacedBeam& beam, const Run& run, size_t k, int weight) const;

  double knots_per_m_;
  std::vector<Eigen::Vector2d> hits_;  // in knots
  std::vector<double> spacings_;       // of a beam and the next one at the hit, in knots
  std::vector<Face> faces_;
};

}  // namespace splinemap
