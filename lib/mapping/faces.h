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
  explicit FaceFinder(double knots_per_m, const ScanKernel& kernel = FastestScanKernel())
      : knots_per_m_(knots_per_m), kernel_(kernel) {}

  // One for each beam, valid until the next call, as the hits beside it tell: beams are in order of
  // their bearings. Lone hits face the sensor.
  absl::Span<const Face> Find(absl::Span<const PlacedBeam> beams);

 private:
  // A run of hits on one surface: beams [begin, end).
  struct Run {
    size_t begin;
    size_t end;
  };
  void SetHits(absl::Span<const PlacedBeam> beams);
  int WeightOf(absl::Span<const PlacedBeam> beams, const Run& run) const;
  void SetChords(const Run& run, int weight);

  double knots_per_m_;
  const ScanKernel& kernel_;
  // See Hits.
  std::vector<double> x_;
  std::vector<double> y_;
  std::vector<double> spacings_;
  std::vector<int32_t> aside_;
  std::vector<int32_t> is_beside_;
  std::vector<Chord> chords_;
  std::vector<Face> faces_;
};

}  // namespace splinemap
