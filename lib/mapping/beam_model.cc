#include "lib/mapping/beam_model.h"

#include <cmath>

#include "lib/spline/basis.h"

namespace splinemap {

BeamModel::BeamModel(const BeamModelOptions& options, double knot_interval_m)
    : knot_interval_m_(knot_interval_m),
      free_sample_spacing_m_(options.free_sample_spacing_knots * knot_interval_m),
      weights_(MakeTable(1 << kWeightBits)),
      hit_weights_(MakeTable(options.kappa_hit * ScanScratch::kUnitsPerLogOdds)),
      free_weights_(MakeTable(options.kappa_free * ScanScratch::kUnitsPerLogOdds)) {}

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

void BeamModel::Accumulate(absl::Span<const PlacedBeam> beams, ScanScratch& scratch) const {
  for (const PlacedBeam& beam : beams) {
    if (beam.hit) {
      AddMeasurement(beam.origin_world_m + beam.range_m * beam.direction_world, hit_weights_,
                     scratch);
    }
    const auto samples = static_cast<int>(std::floor(beam.range_m / free_sample_spacing_m_));
    for (int j = 0; j < samples; ++j) {
      AddMeasurement(beam.origin_world_m + (j * free_sample_spacing_m_) * beam.direction_world,
                     free_weights_, scratch);
    }
  }
}

void BeamModel::AddMeasurement(const Eigen::Vector2d& point_m, const WeightTable& kappa_weights,
                               ScanScratch& scratch) const {
  const auto x = static_cast<int64_t>(std::floor(point_m.x() / knot_interval_m_ * kPhases + 0.5));
  const auto y = static_cast<int64_t>(std::floor(point_m.y() / knot_interval_m_ * kPhases + 0.5));
  const auto i = static_cast<int32_t>(x >> 8) - 1;
  const auto j = static_cast<int32_t>(y >> 8) - 1;
  const std::array<int32_t, 4>& wx = kappa_weights[x & (kPhases - 1)];
  const std::array<int32_t, 4>& wy = weights_[y & (kPhases - 1)];
  for (int row = 0; row < 4; ++row) {
    for (int column = 0; column < 4; ++column) {
      constexpr int32_t kHalf = 1 << (kWeightBits - 1);
      scratch.At(i + column, j + row) += (wx[column] * wy[row] + kHalf) >> kWeightBits;
    }
  }
}

}  // namespace splinemap
