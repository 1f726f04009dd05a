#pragma once

#include <Eigen/Core>
#include <random>
#include <vector>

#include "splinemap/scan.h"

namespace splinemap {

// A corridor from end to end, 12 x 2 m, with a room behind a door, 0.9 m wide, in its wall at y = 1
// m. A robot stands before it and turns 360 beams, noise of ranges 1 cm. Immutable.
class Corridor {
 public:
  explicit Corridor(const Eigen::Vector2d& robot_m = Eigen::Vector2d::Zero());

  std::vector<PlacedBeam> Scan(bool closed, std::mt19937_64& random) const;

  // Where the beams hit the door when it is closed.
  const std::vector<Eigen::Vector2d>& door_points_m() const { return door_points_m_; }

 private:
  std::vector<PlacedBeam> open_;
  std::vector<PlacedBeam> closed_;
  std::vector<Eigen::Vector2d> door_points_m_;
};

}  // namespace splinemap
