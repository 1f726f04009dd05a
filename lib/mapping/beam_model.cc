#include "lib/mapping/beam_model.h"

#include <algorithm>
#include <cmath>

#include "lib/geometry/angle.h"
#include "lib/spline/basis.h"

namespace splinemap {
namespace {

// Sets `line` to the control point rows between the ends of a line from (x, y) over `dy` rows,
// whose dx/dy is `slope`, |slope| <= 1. False where it crosses none.
bool SetLineOverRows(double x, double y, double dy, double slope, const FreeLineTable& table,
                     FreeLine& line) {
  const int64_t first_row = FloorToInt(dy < 0 ? y + dy : y) + 1;
  const int64_t last_row = FloorToInt(dy < 0 ? y : y + dy);
  constexpr double kOne = int64_t{1} << FreeLine::kFractionBits;
  constexpr double kHalfPhase = 0.5 / FreeLine::kPhases;
  const FreeLineTable::Entry entry = table.Find(slope);
  const double column = x + (static_cast<double>(first_row) - y) * slope + entry.first_column;
  line.column = RoundToInt((column + kHalfPhase) * kOne);
  line.columns_per_row = static_cast<int32_t>(RoundToInt(slope * kOne));
  line.first_row = static_cast<int32_t>(first_row);
  line.rows = static_cast<int32_t>(last_row - first_row) + 1;
  line.row_pairs = entry.row_pairs;
  return line.rows > 0;
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
  for (const PlacedBeam& beam : beams) {
    if (!beam.hit) continue;
    samples_.push_back(SampleAt(
        (beam.origin_world_m + beam.range_m * beam.direction_world) * knots_per_m_, hit_weights_));
  }
  if (free_space_ == FreeSpace::kSamples) {
    for (const PlacedBeam& beam : beams) AddFreeSamples(beam);
  } else {
    AddFreeLines(beams, scratch);
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

// The last sample of (9) lies between one and two spacings before the hit. Over all phases that
// makes a density that ends one spacing before it.
void BeamModel::AddFreeLines(absl::Span<const PlacedBeam> beams, ScanScratch& scratch) {
  steep_lines_.resize(beams.size());
  shallow_lines_.resize(beams.size());
  size_t steep = 0;
  size_t shallow = 0;
  for (const PlacedBeam& beam : beams) {
    const double length_knots = beam.range_m * knots_per_m_ - free_sample_spacing_knots_;
    if (length_knots <= 0) continue;
    const Eigen::Vector2d from = beam.origin_world_m * knots_per_m_;
    const Eigen::Vector2d& direction = beam.direction_world;
    if (std::abs(direction.y()) >= std::abs(direction.x())) {
      steep += SetLineOverRows(from.x(), from.y(), length_knots * direction.y(),
                               direction.x() / direction.y(), free_lines_, steep_lines_[steep]);
    } else {
      shallow +=
          SetLineOverRows(from.y(), from.x(), length_knots * direction.x(),
                          direction.y() / direction.x(), free_lines_, shallow_lines_[shallow]);
    }
  }
  scratch.AddSteepLines({steep_lines_.data(), steep});
  scratch.AddShallowLines({shallow_lines_.data(), shallow});
}

PointSample BeamModel::SampleAt(const Eigen::Vector2d& point_knots,
                                const WeightTable& kappa_weights) const {
  const int64_t x = RoundToInt(point_knots.x() * kPhases);
  const int64_t y = RoundToInt(point_knots.y() * kPhases);
  return {static_cast<int32_t>(x >> 8) - 1, static_cast<int32_t>(y >> 8) - 1,
          kappa_weights[x & (kPhases - 1)].data(), weights_[y & (kPhases - 1)].data()};
}

}  // namespace splinemap
