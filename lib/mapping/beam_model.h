#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <vector>

#include "absl/types/span.h"
#include "lib/mapping/faces.h"
#include "lib/mapping/free_line_table.h"
#include "lib/mapping/scan_scratch.h"
#include "splinemap/beam_model_options.h"
#include "splinemap/scan.h"

namespace splinemap {

// Turns placed beams into sums over control points. Thread-compatible.
class BeamModel {
 public:
  BeamModel(const BeamModelOptions& options, double knot_interval_m,
            const ScanKernel& kernel = FastestScanKernel());

  // Adds the measurements of all beams to `scratch`. Signed distances: up to near the hit control
  // points are free; around it a control point's signed distance is that to the face, which is a
  // plane through the hit, and so the surface's level 0 lies on the face, whatever the incidence.
  // The paper's: per hit kappa_hit at range r (8), and kappa_free over the free space before it
  // (9), each by the update (35).
  void Accumulate(absl::Span<const PlacedBeam> beams, ScanScratch& scratch);
  // The same into lines that a scratch takes later. Requires signed distances.
  void AddLines(absl::Span<const PlacedBeam> beams, ScanLines& lines);

 private:
  // A position within a knot interval is rounded to 1/256 of it, 0.2 mm for knots 0.05 m apart.
  static constexpr int kPhases = 256;
  using WeightTable = std::array<std::array<int32_t, 4>, kPhases>;

  static WeightTable MakeTable(double scale);
  PointSample SampleAt(const Eigen::Vector2d& point_knots, const WeightTable& kappa_weights) const;
  void AddFreeSamples(const PlacedBeam& beam);
  void AddPaperUpdates(absl::Span<const PlacedBeam> beams, ScanScratch& scratch);

  BeamUpdate update_;
  double knots_per_m_;
  double free_sample_spacing_knots_;
  WeightTable weights_;       // NormalizedBasis, fixed point with PointSample::kWeightBits
  WeightTable hit_weights_;   // the same times kappa_hit, in units of the scratch
  WeightTable free_weights_;  // and times kappa_free
  std::optional<FreeLineTable<int32_t>> paper_lines_;  // of kPaperLine alone

  const ScanKernel& kernel_;
  FaceFinder faces_;

  std::vector<PointSample> samples_;  // of the beams at hand; kept for its memory
};

}  // namespace splinemap
