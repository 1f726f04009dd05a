#pragma once

#include <cstdint>
#include <vector>

#include "absl/types/span.h"
#include "lib/mapping/scan_kernel.h"
#include "lib/mapping/sum_plane.h"
#include "splinemap/layer.h"
#include "splinemap/scan.h"
#include "splinemap/tile.h"

namespace splinemap {

// Sums of the measurements of one scan by control point, in fixed point, exact and independent of
// the order. Keeps its memory from scan to scan. Thread-compatible.
//
// No overflow: one beam adds at most 7.2 log-odds to a control point (a hit 16/9 * kMaxKappaHit;
// free samples, at least kMinFreeSampleSpacingKnots apart, 4/3 * 3.5 * |kMinKappaFree|), and
// kMaxBeams of them stay within 32 bits.
class ScanScratch {
 public:
  explicit ScanScratch(const ScanKernel& kernel = FastestScanKernel()) : kernel_(kernel) {}

  // 64 units are one unit of a control point.
  static constexpr int kFractionBits = kSumFractionBits;
  static constexpr int kUnitsPerLogOdds = splinemap::kUnitsPerLogOdds << kFractionBits;

  // The sum of control point (i, j), as far as At() and AddSamples() made it. The reference is
  // valid until the next commit.
  int32_t& At(int32_t i, int32_t j);

  void AddSamples(absl::Span<const PointSample> samples) {
    kernel_.add_samples(samples.data(), samples.size(), upright_);
  }
  void AddFreeLines(absl::Span<const PlacedBeam> beams, const FreeLineModel& model);

  // Adds all sums to the layer as one commit, each rounded once and kept within `scan_limits`, the
  // results clamped to `limits` (36), and clears the scratch. A control point whose sum rounds to 0
  // is left as it was.
  void CommitTo(Layer& layer, ControlLimits limits, ControlLimits scan_limits = {});

 private:
  void MoveAprons(SumPlane& plane) const;
  void MoveTransposedToUpright();

  const ScanKernel& kernel_;
  SumPlane upright_;
  SumPlane transposed_;  // x and y exchanged

  // Of the beams at hand; kept for their memory.
  std::vector<FreeLine> steep_lines_;
  std::vector<FreeLine> shallow_lines_;
};

}  // namespace splinemap
