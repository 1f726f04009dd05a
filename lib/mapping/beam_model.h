#pragma once

#include <array>
#include <cstdint>

#include "absl/types/span.h"
#include "lib/mapping/scan_scratch.h"
#include "lib/sensing/scan.h"

namespace splinemap {

// Defaults are the paper's.
struct BeamModelOptions {
  double kappa_hit = 0.9;                   // log-odds that a hit adds to the surface at its point
  double kappa_free = -0.3;                 // log-odds that a free sample adds
  double free_sample_spacing_knots = 1.41;  // distance of the free samples along a beam
};

// Limits within which the sums of a scan cannot overflow; see ScanScratch.
inline constexpr double kMaxKappaHit = 4;
inline constexpr double kMinKappaFree = -1.5;
inline constexpr double kMinFreeSampleSpacingKnots = 1;

// Turns placed beams into sums over control points. Section III-A of the paper, sampled: the plain
// reference that every faster kernel has to equal byte for byte. Immutable.
class BeamModel {
 public:
  BeamModel(const BeamModelOptions& options, double knot_interval_m);

  // Adds the measurements of all beams to `scratch`: per hit kappa_hit at range r (8), and
  // kappa_free at every free sample (9), each by the update (35).
  void Accumulate(absl::Span<const PlacedBeam> beams, ScanScratch& scratch) const;

 private:
  // A position within a knot interval is rounded to 1/256 of it, 0.2 mm for knots 0.05 m apart.
  static constexpr int kPhases = 256;
  static constexpr int kWeightBits = 12;
  using WeightTable = std::array<std::array<int32_t, 4>, kPhases>;

  static WeightTable MakeTable(double scale);
  void AddMeasurement(const Eigen::Vector2d& point_m, const WeightTable& kappa_weights,
                      ScanScratch& scratch) const;

  double knot_interval_m_;
  double free_sample_spacing_m_;
  WeightTable weights_;       // NormalizedBasis, fixed point with kWeightBits
  WeightTable hit_weights_;   // the same times kappa_hit, in units of the scratch
  WeightTable free_weights_;  // and times kappa_free
};

}  // namespace splinemap
