#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "absl/types/span.h"
#include "lib/mapping/faces.h"
#include "lib/mapping/free_line_table.h"
#include "lib/mapping/scan_scratch.h"
#include "splinemap/scan.h"

namespace splinemap {

// What a beam says of the control points around it.
enum class BeamUpdate {
  kSignedDistance,  // how far they lie before or behind the face that it hits
  kPaperSamples,    // the paper's (8) and (9): log-odds, those of free space at points that lie
                    // free_sample_spacing_knots apart
  kPaperLine,       // the expectation of that over the phase of the points
};

struct BeamModelOptions {
  BeamUpdate update = BeamUpdate::kSignedDistance;
  // Of the paper's updates.
  double kappa_hit = 0.9;                   // log-odds that a hit adds to the surface at its point
  double kappa_free = -0.3;                 // log-odds that a free sample adds
  double free_sample_spacing_knots = 1.41;  // distance of the free samples along a beam
};

// Limits within which the sums of a scan cannot overflow; see ScanScratch.
inline constexpr double kMaxKappaHit = 4;
inline constexpr double kMinKappaFree = -1.5;
inline constexpr double kMinFreeSampleSpacingKnots = 1;

// Turns placed beams into sums over control points. Thread-compatible.
class BeamModel {
 public:
  BeamModel(const BeamModelOptions& options, double knot_interval_m);

  // Adds the measurements of all beams to `scratch`. Signed distances: up to near the hit control
  // points are free; around it a control point's signed distance is that to the face, which is a
  // plane through the hit, and so the surface's level 0 lies on the face, whatever the incidence.
  // The paper's: per hit kappa_hit at range r (8), and kappa_free over the free space before it
  // (9), each by the update (35).
  void Accumulate(absl::Span<const PlacedBeam> beams, ScanScratch& scratch);

 private:
  // A position within a knot interval is rounded to 1/256 of it, 0.2 mm for knots 0.05 m apart.
  static constexpr int kPhases = 256;
  using WeightTable = std::array<std::array<int32_t, 4>, kPhases>;

  static WeightTable MakeTable(double scale);
  PointSample SampleAt(const Eigen::Vector2d& point_knots, const WeightTable& kappa_weights) const;
  void AddFreeSamples(const PlacedBeam& beam);
  void AddSignedDistances(absl::Span<const PlacedBeam> beams, ScanScratch& scratch);
  void AddPaperUpdates(absl::Span<const PlacedBeam> beams, ScanScratch& scratch);

  BeamUpdate update_;
  double knots_per_m_;
  double free_sample_spacing_knots_;
  WeightTable weights_;       // NormalizedBasis, fixed point with PointSample::kWeightBits
  WeightTable hit_weights_;   // the same times kappa_hit, in units of the scratch
  WeightTable free_weights_;  // and times kappa_free
  FreeLineTable<int32_t> paper_lines_;
  FreeLineTable<uint16_t> free_lines_;
  FaceLineTable face_lines_;

  FaceFinder faces_;

  std::vector<PointSample> samples_;  // of the beams at hand; kept for its memory
};

}  // namespace splinemap
