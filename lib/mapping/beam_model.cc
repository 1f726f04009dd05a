#include "lib/mapping/beam_model.h"

#include <cmath>

#include "lib/geometry/angle.h"
#include "lib/spline/basis.h"

namespace splinemap {
namespace {

constexpr size_t kSamplesAtOnce = size_t{1} << 16;

}  // namespace

BeamModel::BeamModel(const BeamModelOptions& options, double knot_interval_m,
                     const ScanKernel& kernel)
    : update_(options.update),
      knots_per_m_(1 / knot_interval_m),
      free_sample_spacing_knots_(options.free_sample_spacing_knots),
      weights_(MakeTable(1 << PointSample::kWeightBits)),
      hit_weights_(MakeTable(options.kappa_hit * ScanScratch::kUnitsPerLogOdds)),
      free_weights_(MakeTable(options.kappa_free * ScanScratch::kUnitsPerLogOdds)),
      kernel_(kernel),
      faces_(knots_per_m_, kernel) {
  if (update_ != BeamUpdate::kPaperLine) return;
  paper_lines_.emplace(
      options.kappa_free * ScanScratch::kUnitsPerLogOdds / options.free_sample_spacing_knots,
      Footprint::kNormalizedBasis);
}

BeamModel::WeightTable BeamModel::MakeTable(double scale) {
  WeightTable table;
  for (int phase = 0; phase < kPhases; ++phase) {
    const BasisWeights weights = NormalizedBasis(phase / double{kPhases});
    for (int k = 0; k < 4; ++k) {
      table[phase][k] = static_cast<int32_t>(std::lround(scale * weights[k]));
    }
  }
  return table;
}

void BeamModel::Accumulate(absl::Span<const PlacedBeam> beams, ScanScratch& scratch) {
  if (update_ == BeamUpdate::kSignedDistance) {
    AddLines(beams, scratch.lines());
  } else {
    AddPaperUpdates(beams, scratch);
  }
}

void BeamModel::AddLines(absl::Span<const PlacedBeam> beams, ScanLines& lines) {
  lines.Add(beams, faces_.Find(beams), knots_per_m_, kernel_);
}

void BeamModel::AddPaperUpdates(absl::Span<const PlacedBeam> beams, ScanScratch& scratch) {
  samples_.clear();
  for (const PlacedBeam& beam : beams) {
    if (!beam.hit) continue;
    samples_.push_back(SampleAt(
        (beam.origin_world_m + beam.range_m * beam.direction_world) * knots_per_m_, hit_weights_));
  }
  if (update_ == BeamUpdate::kPaperSamples) {
    for (const PlacedBeam& beam : beams) {
      AddFreeSamples(beam);
      if (samples_.size() < kSamplesAtOnce) continue;
      scratch.AddSamples(samples_);
      samples_.clear();
    }
  } else {
    // The last sample of (9) lies between one and two spacings before the hit. Over all phases that
    // makes a density that ends one spacing before it.
    scratch.AddFreeLines(
        beams, {.knots_per_m = knots_per_m_, .end_before_hit_knots = free_sample_spacing_knots_},
        *paper_lines_);
  }
  scratch.AddSamples(samples_);
}

void BeamModel::AddFreeSamples(const PlacedBeam& beam) {
  const Eigen::Vector2d origin_knots = beam.origin_world_m * knots_per_m_;
  const auto count =
      static_cast<int>(std::floor(beam.range_m * knots_per_m_ / free_sample_spacing_knots_));
  for (int j = 0; j < count; ++j) {
    samples_.push_back(SampleAt(
        origin_knots + (j * free_sample_spacing_knots_) * beam.direction_world, free_weights_));
  }
}

PointSample BeamModel::SampleAt(const Eigen::Vector2d& point_knots,
                                const WeightTable& kappa_weights) const {
  const int64_t x = RoundToInt(point_knots.x() * kPhases);
  const int64_t y = RoundToInt(point_knots.y() * kPhases);
  return {static_cast<int32_t>(x >> 8) - 1, static_cast<int32_t>(y >> 8) - 1,
          kappa_weights[x & (kPhases - 1)].data(), weights_[y & (kPhases - 1)].data()};
}

}  // namespace splinemap
