#include "lib/mapping/scan_folder.h"

#include <algorithm>
#include <utility>

#include "lib/base/status.h"
#include "splinemap/fixed_pose2.h"

namespace splinemap {
namespace {

// So that no scan from a bus or a file takes much longer, or more memory, than one can that is well
// meant: 16,384 beams of 100 m at knots of 5 cm, from within 50 m.
constexpr double kMaxSumKnots = 1 << 25;
constexpr double kMaxWayKnots = 1024;

}  // namespace

double ScanFolder::MaxCoordinate_m(const MapOptions& options) {
  return std::min(0.9 * kMaxKnotIndex * options.knot_interval_m,
                  FixedPose2::kMaxUnits / FixedPose2::kUnitsPerMetre);
}

absl::Status ScanFolder::Check(const PlacedScan& scan) const {
  const double max_coordinate_m = MaxCoordinate_m(options_);
  double beams_m = 0;
  const double max_range_m = kMaxReachKnots * options_.knot_interval_m;
  for (const PlacedBeam& beam : scan.beams) {
    if (const Eigen::Vector2d& p = beam.origin_world_m;
        !(p.cwiseAbs().maxCoeff() <= max_coordinate_m)) {
      return InvalidArgument("a scan from ({}, {}) m; {:.0f} m is the most", p.x(), p.y(),
                             max_coordinate_m);
    }
    // Config says the same of range_max_m, up to rounding.
    if (beam.range_m > 1.001 * max_range_m) {
      return InvalidArgument("a beam of {:.1f} m; with knots {} m apart {:.1f} m are the most",
                             beam.range_m, options_.knot_interval_m, max_range_m);
    }
    const double way_m = (beam.origin_world_m - scan.beams.front().origin_world_m).norm();
    if (way_m > kMaxWayKnots * options_.knot_interval_m) {
      return InvalidArgument("a scanner that moves by {:.1f} m in a scan", way_m);
    }
    beams_m += beam.range_m;
  }
  if (beams_m > kMaxSumKnots * options_.knot_interval_m) {
    return InvalidArgument("beams of {:.0f} m in all", beams_m);
  }
  return absl::OkStatus();
}

void ScanFolder::Fold(const PlacedScan& scan, const BeamModelOptions& model, Layer& layer) {
  Accumulate(scan, model);
  scratch_.CommitTo(layer, options_.limits);
}

void ScanFolder::Fold(const PlacedScan& scan, const BeamModelOptions& model, uint64_t revision,
                      TileTreeEditor& tiles, absl::FunctionRef<bool(TileKey)> is_taken) {
  Accumulate(scan, model);
  scratch_.CommitTo(tiles, revision, options_.limits, {}, is_taken);
}

void ScanFolder::Prepare(const PlacedScan& scan, const BeamModelOptions& model, ScanLines& lines) {
  lines.Clear();
  if (model.update == BeamUpdate::kSignedDistance) ModelOf(model).AddLines(scan.beams, lines);
}

void ScanFolder::FoldPrepared(const PlacedScan& scan, const BeamModelOptions& model,
                              ScanLines& lines, Layer& layer) {
  if (model.update == BeamUpdate::kSignedDistance) {
    std::swap(lines, scratch_.lines());
  } else {
    Accumulate(scan, model);
  }
  scratch_.CommitTo(layer, options_.limits);
}

void ScanFolder::Accumulate(const PlacedScan& scan, const BeamModelOptions& model) {
  ModelOf(model).Accumulate(scan.beams, scratch_);
}

BeamModel& ScanFolder::ModelOf(const BeamModelOptions& model) {
  if (!model_ || model_options_ != model) {
    model_options_ = model;
    model_.emplace(model, options_.knot_interval_m, kernel_);
  }
  return *model_;
}

}  // namespace splinemap
