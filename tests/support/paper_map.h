#pragma once

#include "splinemap/scan.h"
#include "tests/support/sparse_grid.h"

namespace splinemap {

// The map as the paper has it: update (36) after every measurement, in double, with the paper's
// parameters. The oracle for the project's integers. Thread-compatible.
class PaperMap {
 public:
  static constexpr double kLimitLogOdds = 100;

  explicit PaperMap(double knot_interval_m) : knot_interval_m_(knot_interval_m) {}

  void Add(const PlacedBeam& beam);
  // The surface s in log-odds.
  double Evaluate(double x_m, double y_m) const;
  size_t tiles() const { return control_points_.tiles(); }

 private:
  void Measure(const Eigen::Vector2d& point_m, double kappa);

  double knot_interval_m_;
  SparseGrid control_points_;
};

}  // namespace splinemap
