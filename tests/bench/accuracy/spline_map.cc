#include "tests/bench/accuracy/spline_map.h"

#include <cmath>

#include "lib/mapping/scan_scratch.h"
#include "tests/support/paper_map.h"

namespace splinemap {
namespace {

class SplineMap : public TestedMap {
 public:
  SplineMap(const Variant& variant, double knot_interval_m)
      : TestedMap(variant.limits.max / double{kUnitsPerLogOdds}),
        scan_limits_(variant.scan_limits),
        model_(variant.beams, knot_interval_m),
        map_({knot_interval_m, variant.limits}),
        layer_(map_.AddLayer({"robot", 1}, {1, 1})) {}

  void AddScan(absl::Span<const PlacedBeam> beams) override {
    model_.Accumulate(beams, scratch_);
    scratch_.CommitTo(layer_, map_.options().limits, scan_limits_);
    snapshot_ = nullptr;
  }

  double LogOdds(const Eigen::Vector2d& point_m) override {
    if (snapshot_ == nullptr) snapshot_ = map_.Snapshot();
    const SurfaceSample sample = snapshot_->Evaluate(point_m.x(), point_m.y());
    return sample.known ? sample.log_odds : 0;
  }

  int64_t Bytes() const override {
    return static_cast<int64_t>(layer_.tiles().size() * sizeof(Tile));
  }

 private:
  ControlLimits scan_limits_;
  BeamModel model_;
  ScanScratch scratch_;
  Map map_;
  Layer& layer_;
  std::shared_ptr<const MapSnapshot> snapshot_;  // null after a scan
};

class PaperSplineMap : public TestedMap {
 public:
  explicit PaperSplineMap(double knot_interval_m)
      : TestedMap(PaperMap::kLimitLogOdds), map_(knot_interval_m) {}

  void AddScan(absl::Span<const PlacedBeam> beams) override {
    for (const PlacedBeam& beam : beams) map_.Add(beam);
  }
  double LogOdds(const Eigen::Vector2d& point_m) override {
    return map_.Evaluate(point_m.x(), point_m.y());
  }
  int64_t Bytes() const override { return static_cast<int64_t>(map_.tiles() * sizeof(Tile)); }

 private:
  PaperMap map_;
};

ControlLimits Limits(double min_log_odds, double max_log_odds) {
  return {static_cast<ControlPoint>(std::lround(min_log_odds * kUnitsPerLogOdds)),
          static_cast<ControlPoint>(std::lround(max_log_odds * kUnitsPerLogOdds))};
}

ControlLimits Limits(double log_odds) { return Limits(-log_odds, log_odds); }

}  // namespace

std::vector<Variant> Variants() {
  const ControlLimits paper;
  const BeamModelOptions free_15 = {.kappa_free = -0.15};
  const BeamModelOptions free_10 = {.kappa_free = -0.1};
  return {
      {"paper", {}, paper, paper, false, true},
      // Clamps.
      {"clamp 50", {}, Limits(50), paper},
      {"clamp 20", {}, Limits(20), paper},
      {"clamp 10", {}, Limits(10), paper, false, true},
      {"clamp 5", {}, Limits(5), paper},
      {"clamp -5 +10", {}, Limits(-5, 10), paper},
      // Limits on what one scan changes.
      {"cap 4", {}, paper, Limits(4)},
      {"cap 2", {}, paper, Limits(2)},
      {"cap 1", {}, paper, Limits(1)},
      {"cap -0.6 +1.8", {}, paper, Limits(-0.6, 1.8)},
      {"cap -0.3 +0.9", {}, paper, Limits(-0.3, 0.9)},
      {"clamp 10 cap 4", {}, Limits(10), Limits(4)},
      {"clamp 10 cap 2", {}, Limits(10), Limits(2)},
      {"clamp 10 cap -1 +3", {}, Limits(10), Limits(-1, 3)},
      {"clamp 10 cap -0.5 +2", {}, Limits(10), Limits(-0.5, 2)},
      {"clamp 5 cap 2", {}, Limits(5), Limits(2)},
      {"clamp 5 cap 1", {}, Limits(5), Limits(1)},
      // Beams without return.
      {"no return free", {}, paper, paper, true},
      {"clamp 10 no return free", {}, Limits(10), paper, true},
      // Less evidence for free space.
      {"free -0.15", free_15, paper, paper, false, true},
      {"clamp 10 free -0.15", free_15, Limits(10), paper, false, true},
      {"clamp 10 cap 4 free -0.15", free_15, Limits(10), Limits(4)},
      {"clamp -5 +10 free -0.15", free_15, Limits(-5, 10), paper},
      {"clamp 5 free -0.15", free_15, Limits(5), paper},
      {"clamp 10 free -0.1", free_10, Limits(10), paper},
      {"clamp 5 free -0.1", free_10, Limits(5), paper},
  };
}

Method SplineMethod(const Variant& variant) {
  return {
      "spline " + variant.name,
      [variant](double resolution_m) { return std::make_unique<SplineMap>(variant, resolution_m); },
      variant.no_return_is_free};
}

Method PaperSplineMethod() {
  return {"spline in double",
          [](double resolution_m) { return std::make_unique<PaperSplineMap>(resolution_m); }};
}

}  // namespace splinemap
