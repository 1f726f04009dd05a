#pragma once

#include <vector>

#include "tests/bench/speed/workload.h"

namespace splinemap::bench {

// The paper's update as it is printed: for each measurement the basis at its point, (35), (36), in
// double. Its control points are one dense array that covers `bounds_m`.
class DensePaperMap {
 public:
  explicit DensePaperMap(const Eigen::AlignedBox2d& bounds_m);

  void Insert(const RecordedScan& scan);

 private:
  void Measure(const Eigen::Vector2d& point_m, double kappa);

  Eigen::Vector2d corner_m_;
  int width_;
  std::vector<double> control_points_;
};

}  // namespace splinemap::bench
