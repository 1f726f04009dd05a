#pragma once

#include <cstdint>
#include <vector>

#include "absl/functional/function_ref.h"
#include "absl/types/span.h"
#include "lib/mapping/scan_kernel.h"
#include "lib/mapping/sum_plane.h"
#include "splinemap/layer.h"
#include "splinemap/scan.h"
#include "splinemap/tile.h"

namespace splinemap {

// Lines by the axis that they are steep to. The vectors keep their memory, and have space for one
// more, which kernels write.
template <typename Line>
struct LinesByAxis {
  std::vector<Line> steep;
  std::vector<Line> shallow;
  size_t num_steep = 0;
  size_t num_shallow = 0;
  void MakeSpace(size_t count);
  void Clear() { num_steep = num_shallow = 0; }
};

// Beams as lines of signed distances: up to near their faces, and around them.
struct ScanLines {
  LinesByAxis<FreeLine> free;
  LinesByAxis<FaceLine> faces;
  // Of beams with a face each.
  void Add(absl::Span<const PlacedBeam> beams, absl::Span<const Face> faces_of_beams,
           double knots_per_m, const ScanKernel& kernel);
  void Clear();
};

// Sums of the measurements of one scan by control point, in fixed point, exact and independent of
// the order. Keeps its memory from scan to scan. Thread-compatible.
//
// Sums are of the paper's update (35): log-odds. Or they are of signed distances: the weight of all
// beams that pass a control point, and the part of it that says occupied. One scan has one kind.
//
// No overflow: one beam adds at most 7.2 log-odds to a control point (a hit 16/9 * kMaxKappaHit;
// free samples, at least kMinFreeSampleSpacingKnots apart, 4/3 * 3.5 * |kMinKappaFree|), and
// kMaxBeams of them stay within 32 bits. So do weights of faces: a beam adds at most
// kMostFaceWeight times the diagonal of a knot cell. Weights of free space saturate at 182 knots of
// beams: a face nearer to the sensor than beams lie 1/182 knot apart, 6 cm with 0.25 degrees
// between them, counts more against them than it should.
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
    kernel_.add_samples(samples.data(), samples.size(), log_odds_.upright);
  }
  void AddFreeLines(absl::Span<const PlacedBeam> beams, const FreeLineModel& model,
                    const FreeLineTable<int32_t>& table);
  // The lines whose signed distances wait for the commit, which clears them.
  ScanLines& lines() { return lines_; }

  // Brings all sums into the layer as one commit, the results clamped to `limits` (36), and clears
  // the scratch.
  // Log-odds are added, each rounded once and kept within `scan_limits`; a control point whose sum
  // rounds to 0 is left as it was.
  // Signed distances are averaged, in units of control points d = kFree + (kOccupied - kFree) *
  // occupied / weight: c += (d - c) * min(weight, kMostWeight) / 2^kForgetBits, and c = d at a
  // control point that was never touched.
  void CommitTo(Layer& layer, ControlLimits limits, ControlLimits scan_limits = {});
  // The same into those tiles for which `is_taken` is true, which is asked once for each that would
  // change; changes are stamped with `revision`.
  void CommitTo(TileTreeEditor& tiles, uint64_t revision, ControlLimits limits,
                ControlLimits scan_limits, absl::FunctionRef<bool(TileKey)> is_taken);

 private:
  // Sums by the axis that their beams are steep to.
  template <typename Sum>
  struct Planes {
    SumPlane<Sum> upright;
    SumPlane<Sum> transposed;  // x and y exchanged
  };

  struct Commit {
    TileTreeEditor& tiles;
    uint64_t revision;
    ControlLimits limits;
    absl::FunctionRef<bool(TileKey)> is_taken;
  };
  void CommitSums(const Commit& commit, ControlLimits scan_limits);
  void CommitDistances(const Commit& commit);
  // The lines of beams, but for what cannot change the tiles any more.
  void AddUnsettledLines(const Commit& commit);
  // Sets what free lines leave out of a block.
  void MarkSettled(const Commit& commit, bool is_transposed, SumBlock<uint16_t>& block) const;
  // All to `upright`, without aprons.
  template <typename Sum>
  static void Collect(const TileKernel<Sum>& kernel, Planes<Sum>& planes);
  template <typename Sum>
  static void MoveAprons(const TileKernel<Sum>& kernel, SumPlane<Sum>& plane);

  const ScanKernel& kernel_;
  Planes<int32_t> log_odds_;
  Planes<uint16_t> free_;
  Planes<FaceSum> faces_;

  ScanLines lines_;
};

}  // namespace splinemap
