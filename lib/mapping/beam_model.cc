#include "lib/mapping/beam_model.h"

#include <algorithm>
#include <cmath>
#include <optional>

#include "lib/geometry/angle.h"
#include "lib/spline/basis.h"

namespace splinemap {
namespace {

// From (x, y) over `dy` rows with the slope dx/dy = `slope`, |slope| <= 1: the control point rows
// between its ends. Nothing where it crosses none.
std::optional<FreeLine> LineOverRows(double x, double y, double dy, double slope) {
  const int64_t first_row = FloorToInt(std::min(y, y + dy)) + 1;
  const int64_t last_row = FloorToInt(std::max(y, y + dy));
  if (last_row < first_row) return std::nullopt;
  constexpr double kOne = int64_t{1} << FreeLine::kFractionBits;
  constexpr double kHalfPhase = 0.5 / FreeLine::kPhases;
  const double column = x + (static_cast<double>(first_row) - y) * slope +
                        FreeLineTable::FirstColumn(slope) + kHalfPhase;
  FreeLine line;
  line.column = RoundToInt(column * kOne);
  line.columns_per_row = static_cast<int32_t>(RoundToInt(slope * kOne));
  line.first_row = static_cast<int32_t>(first_row);
  line.rows = static_cast<int32_t>(last_row - first_row) + 1;
  return line;
}

}  // namespace

BeamModel::BeamModel(const BeamModelOptions& options, double knot_interval_m)
    : free_space_(options.free_space),
      knots_per_m_(1 / knot_interval_m),
      free_sample_spacing_knots_(options.free_sample_spacing_knots),
      weights_(MakeTable(1 << PointSample::kWeightBits)),
      hit_weights_(MakeTable(options.kappa_hit * ScanScratch::kUnitsPerLogOdds)),
      free_weights_(MakeTable(options.kappa_free * ScanScratch::kUnitsPerLogOdds)),
      free_lines_(options.kappa_free * ScanScratch::kUnitsPerLogOdds /
                  options.free_sample_spacing_knots) {}

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
  samples_.clear();
  steep_lines_.clear();
  shallow_lines_.clear();
  for (const PlacedBeam& beam : beams) {
    if (beam.hit) {
      samples_.push_back(
          SampleAt((beam.origin_world_m + beam.range_m * beam.direction_world) * knots_per_m_,
                   hit_weights_));
    }
    if (free_space_ == FreeSpace::kSamples) {
      AddFreeSamples(beam);
    } else {
      AddFreeLine(beam);
    }
  }
  scratch.AddSteepLines(steep_lines_);
  scratch.AddShallowLines(shallow_lines_);
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

// The last sample of (9) lies between one and two spacings before the hit. Over all phases that
// makes a density that ends one spacing before it.
void BeamModel::AddFreeLine(const PlacedBeam& beam) {
  const double length_knots = beam.range_m * knots_per_m_ - free_sample_spacing_knots_;
  if (length_knots <= 0) return;
  const Eigen::Vector2d from = beam.origin_world_m * knots_per_m_;
  const Eigen::Vector2d& direction = beam.direction_world;
  const bool is_steep = std::abs(direction.y()) >= std::abs(direction.x());
  const double slope = is_steep ? direction.x() / direction.y() : direction.y() / direction.x();
  std::optional<FreeLine> line =
      is_steep ? LineOverRows(from.x(), from.y(), length_knots * direction.y(), slope)
               : LineOverRows(from.y(), from.x(), length_knots * direction.x(), slope);
  if (!line) return;
  line->row_pairs = free_lines_.RowPairs(slope);
  (is_steep ? steep_lines_ : shallow_lines_).push_back(*line);
}

PointSample BeamModel::SampleAt(const Eigen::Vector2d& point_knots,
                                const WeightTable& kappa_weights) const {
  const int64_t x = RoundToInt(point_knots.x() * kPhases);
  const int64_t y = RoundToInt(point_knots.y() * kPhases);
  return {static_cast<int32_t>(x >> 8) - 1, static_cast<int32_t>(y >> 8) - 1,
          kappa_weights[x & (kPhases - 1)].data(), weights_[y & (kPhases - 1)].data()};
}

}  // namespace splinemap
