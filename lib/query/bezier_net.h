#pragma once

#include <algorithm>
#include <array>
#include <limits>

#include "lib/query/cell_patch.h"

namespace splinemap {

inline constexpr double kInfinity = std::numeric_limits<double>::infinity();

// The surface over a square as a bicubic Bezier net, in units of control points: row k belongs to
// y, column l to x. It lies between the least and the greatest of the net, and comes closer to them
// with the square of the side.
struct BezierNet {
  std::array<std::array<double, 4>, 4> rows;

  // Over a whole knot cell.
  static BezierNet OfCell(const CellPatch& patch) {
    BezierNet net;
    for (int k = 0; k < 4; ++k) {
      const ControlPoint* c = &patch.control_points[4 * k];
      net.rows[k] =
          OfSpline({double{1} * c[0], double{1} * c[1], double{1} * c[2], double{1} * c[3]});
    }
    for (int l = 0; l < 4; ++l) net.SetColumn(l, OfSpline(net.Column(l)));
    return net;
  }

  // Over [x0, x1] x [y0, y1] of it, where it is [0, 1] x [0, 1]; backwards where x0 > x1.
  BezierNet Part(double x0, double x1, double y0, double y1) const {
    BezierNet net;
    for (int k = 0; k < 4; ++k) net.rows[k] = Part(rows[k], x0, x1);
    for (int l = 0; l < 4; ++l) net.SetColumn(l, Part(net.Column(l), y0, y1));
    return net;
  }

  // The quarter on the right (or left) and upper (or lower) side.
  BezierNet Quarter(bool right, bool upper) const {
    BezierNet net;
    for (int k = 0; k < 4; ++k) net.rows[k] = Half(rows[k], right);
    for (int l = 0; l < 4; ++l) net.SetColumn(l, Half(net.Column(l), upper));
    return net;
  }

  double Greatest() const {
    double greatest = rows[0][0];
    for (const auto& row : rows) {
      for (const double value : row) greatest = value > greatest ? value : greatest;
    }
    return greatest;
  }
  double Least() const {
    double least = rows[0][0];
    for (const auto& row : rows) {
      for (const double value : row) least = value < least ? value : least;
    }
    return least;
  }

  // A linear function that is nowhere less than the surface: `at_corner` at (0, 0), by `slope_x`
  // and `slope_y` more from side to side.
  struct Plane {
    double at_corner;
    double slope_x;
    double slope_y;
  };
  Plane Above() const {
    Plane plane;
    plane.slope_x = (rows[0][3] - rows[0][0] + rows[3][3] - rows[3][0]) / 2;
    plane.slope_y = (rows[3][0] - rows[0][0] + rows[3][3] - rows[0][3]) / 2;
    plane.at_corner = rows[0][0];
    for (int k = 0; k < 4; ++k) {
      for (int l = 0; l < 4; ++l) {
        plane.at_corner =
            std::max(plane.at_corner, rows[k][l] - (l * plane.slope_x + k * plane.slope_y) / 3);
      }
    }
    return plane;
  }

  // Along the diagonal from (0, 0) to (1, 1): a polynomial of degree 6 as Bezier coefficients.
  std::array<double, 7> Diagonal() const {
    constexpr double kBinomial3[] = {1, 3, 3, 1};
    constexpr double kBinomial6[] = {1, 6, 15, 20, 15, 6, 1};
    std::array<double, 7> sums{};
    for (int k = 0; k < 4; ++k) {
      for (int l = 0; l < 4; ++l) sums[k + l] += kBinomial3[k] * kBinomial3[l] * rows[k][l];
    }
    for (int m = 0; m < 7; ++m) sums[m] /= kBinomial6[m];
    return sums;
  }

 private:
  using Cubic = std::array<double, 4>;

  // Of a uniform cubic B-spline on the knot interval between its middle control points.
  static Cubic OfSpline(const Cubic& c) {
    return {(c[0] + 4 * c[1] + c[2]) / 6, (2 * c[1] + c[2]) / 3, (c[1] + 2 * c[2]) / 3,
            (c[1] + 4 * c[2] + c[3]) / 6};
  }

  // The blossom at (a, b, c): with equal arguments the value there.
  static double Blossom(const Cubic& q, double a, double b, double c) {
    const double p0 = q[0] + a * (q[1] - q[0]);
    const double p1 = q[1] + a * (q[2] - q[1]);
    const double p2 = q[2] + a * (q[3] - q[2]);
    const double r0 = p0 + b * (p1 - p0);
    const double r1 = p1 + b * (p2 - p1);
    return r0 + c * (r1 - r0);
  }
  static Cubic Part(const Cubic& q, double t0, double t1) {
    return {Blossom(q, t0, t0, t0), Blossom(q, t0, t0, t1), Blossom(q, t0, t1, t1),
            Blossom(q, t1, t1, t1)};
  }
  // De Casteljau's algorithm at 1/2.
  static Cubic Half(const Cubic& q, bool second) {
    const double p0 = (q[0] + q[1]) / 2;
    const double p1 = (q[1] + q[2]) / 2;
    const double p2 = (q[2] + q[3]) / 2;
    const double r0 = (p0 + p1) / 2;
    const double r1 = (p1 + p2) / 2;
    const double middle = (r0 + r1) / 2;
    return second ? Cubic{middle, r1, p2, q[3]} : Cubic{q[0], p0, r0, middle};
  }

  Cubic Column(int l) const { return {rows[0][l], rows[1][l], rows[2][l], rows[3][l]}; }
  void SetColumn(int l, const Cubic& column) {
    for (int k = 0; k < 4; ++k) rows[k][l] = column[k];
  }
};

}  // namespace splinemap
