#pragma once

#include <array>

#include "tests/bench/accuracy/tested_map.h"
#include "tests/support/sparse_grid.h"

namespace splinemap {

// How much each of four neighbouring cells counts at phase t from the second to the third.
using ReadOut = std::array<double, 4> (*)(double t);
std::array<double, 4> Nearest(double t);
std::array<double, 4> Bilinear(double t);
std::array<double, 4> Bicubic(double t);  // Keys 1981, a = -1/2

// The paper's peer: an occupancy grid by (16), kappa 0.9 for the cell of a hit and -0.3 (or
// kappa_free) for those that Bresenham's line passes, clamped after each. Centres of cells are at
// multiples of the resolution. Takes as much memory as the spline: cells count as int16, in tiles
// of 32 x 32.
class GridMap : public TestedMap {
 public:
  GridMap(double resolution_m, double limit_log_odds, ReadOut read_out, double kappa_free);

  void AddScan(absl::Span<const PlacedBeam> beams) override;
  double LogOdds(const Eigen::Vector2d& point_m) override;
  int64_t Bytes() const override;

 private:
  using Cell = Eigen::Vector2i;

  Cell CellOf(const Eigen::Vector2d& point_m) const;
  void AddFree(Cell from, Cell to);
  void Add(Cell cell, double kappa);

  double resolution_m_;
  ReadOut read_out_;
  double kappa_free_;
  SparseGrid cells_;
};

Method GridMethod(const std::string& name, double limit_log_odds, ReadOut read_out,
                  double kappa_free = -0.3);

}  // namespace splinemap
