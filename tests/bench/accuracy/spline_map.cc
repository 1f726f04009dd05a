#include "tests/bench/accuracy/spline_map.h"

#include <cmath>

#include "lib/mapping/scan_scratch.h"
#include "tests/support/map_writer.h"
#include "tests/support/paper_map.h"

namespace splinemap {
namespace {

class SplineMap : public TestedMap {
 public:
  SplineMap(const Variant& variant, double knot_interval_m)
      : TestedMap(variant.limits.max / double{kUnitsPerLogOdds}),
        scan_limits_(variant.scan_limits),
        is_distance_(variant.beams.update == BeamUpdate::kSignedDistance),
        model_(variant.beams, knot_interval_m),
        map_({knot_interval_m, variant.limits}),
        layer_(map_.AddLayer({"robot", 1}, {1, 1})) {}

  void AddScan(absl::Span<const PlacedBeam> beams) override {
    model_.Accumulate(beams, scratch_);
    scratch_.CommitTo(layer_, map_.options().limits, scan_limits_);
    view_ = nullptr;
  }

  double LogOdds(const Eigen::Vector2d& point_m) override {
    if (view_ == nullptr) view_ = map_.View();
    const SurfaceSample sample = view_->Evaluate(point_m.x(), point_m.y());
    if (!sample.known) return 0;
    return is_distance_ ? Variant::LogOddsOfHit(sample.log_odds) : sample.log_odds;
  }

  // A signed distance has no clamp that its values get to.
  double Scaled(const Eigen::Vector2d& point_m) override {
    return is_distance_ ? 2 * Probability(LogOdds(point_m)) - 1 : TestedMap::Scaled(point_m);
  }

  int64_t Bytes() const override {
    return static_cast<int64_t>(layer_.tiles().size() * sizeof(Tile));
  }

 private:
  ControlLimits scan_limits_;
  bool is_distance_;
  BeamModel model_;
  ScanScratch scratch_;
  MapWriter map_;
  Layer& layer_;
  std::shared_ptr<const MapView> view_;  // null after a scan
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
  const BeamModelOptions samples = {.update = BeamUpdate::kPaperSamples};
  const BeamModelOptions samples_15 = {.update = BeamUpdate::kPaperSamples, .kappa_free = -0.15};
  const BeamModelOptions line = {.update = BeamUpdate::kPaperLine};
  const BeamModelOptions line_15 = {.update = BeamUpdate::kPaperLine, .kappa_free = -0.15};
  const BeamModelOptions line_10 = {.update = BeamUpdate::kPaperLine, .kappa_free = -0.1};
  return {
      {"signed distance", {}, Limits(64), paper, false, true, true},
      {"samples", samples, paper, paper, false, true, true},
      {"samples clamp 10", samples, Limits(10), paper},
      {"samples clamp 5", samples, Limits(5), paper},
      {"samples clamp 10 cap 4", samples, Limits(10), Limits(4)},
      {"samples clamp 10 free -0.15", samples_15, Limits(10), paper},
      {"line", line, paper, paper, false, true, true},
      // Clamps.
      {"line clamp 50", line, Limits(50), paper},
      {"line clamp 20", line, Limits(20), paper},
      {"line clamp 10", line, Limits(10), paper, false, true},
      {"line clamp 5", line, Limits(5), paper},
      {"line clamp -5 +10", line, Limits(-5, 10), paper},
      // Limits on what one scan changes.
      {"line cap 4", line, paper, Limits(4)},
      {"line cap 2", line, paper, Limits(2)},
      {"line cap 1", line, paper, Limits(1)},
      {"line cap -0.6 +1.8", line, paper, Limits(-0.6, 1.8)},
      {"line cap -0.3 +0.9", line, paper, Limits(-0.3, 0.9)},
      {"line clamp 10 cap 4", line, Limits(10), Limits(4)},
      {"line clamp 10 cap 2", line, Limits(10), Limits(2)},
      {"line clamp 10 cap -1 +3", line, Limits(10), Limits(-1, 3)},
      {"line clamp 10 cap -0.5 +2", line, Limits(10), Limits(-0.5, 2)},
      {"line clamp 5 cap 2", line, Limits(5), Limits(2)},
      // Beams without return.
      {"line no return free", line, paper, paper, true},
      {"line clamp 10 no return free", line, Limits(10), paper, true},
      // Less evidence for free space.
      {"line free -0.15", line_15, paper, paper},
      {"line clamp 10 free -0.15", line_15, Limits(10), paper, false, true},
      {"line clamp 10 cap 4 free -0.15", line_15, Limits(10), Limits(4)},
      {"line clamp -5 +10 free -0.15", line_15, Limits(-5, 10), paper},
      {"line clamp 5 free -0.15", line_15, Limits(5), paper},
      {"line clamp 10 free -0.1", line_10, Limits(10), paper},
      {"line clamp 5 free -0.1", line_10, Limits(5), paper},
  };
}

double Variant::LevelOfFaces() const {
  return beams.update == BeamUpdate::kSignedDistance ? LogOddsOfHit(0) : 0;
}

Method SplineMethod(const Variant& variant) {
  return {
      "spline " + variant.name,
      [variant](double resolution_m) { return std::make_unique<SplineMap>(variant, resolution_m); },
      variant.no_return_is_free, variant.LevelOfFaces()};
}

Method PaperSplineMethod() {
  return {"spline in double",
          [](double resolution_m) { return std::make_unique<PaperSplineMap>(resolution_m); }};
}

}  // namespace splinemap
