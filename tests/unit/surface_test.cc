#include "splinemap/surface.h"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <memory>
#include <random>
#include <unsupported/Eigen/Splines>

#include "splinemap/map_view.h"
#include "tests/support/map_writer.h"
#include "tests/support/random_map.h"

namespace splinemap::surface_test {

// A spline over a block of control points as the tensor product of Eigen's one-dimensional splines,
// which know nothing of ours: values and derivatives of each basis function come from their tables.
class EigenSurface {
 public:
  EigenSurface(Eigen::MatrixXd control_points, int first_i, int first_j, double knot_interval_m)
      : control_points_(std::move(control_points)),
        first_i_(first_i),
        first_j_(first_j),
        knot_interval_m_(knot_interval_m) {}

  // d^(dx + dy) s / dx^dx dy^dy at a point.
  double Derivative(double x_m, double y_m, int dx, int dy) const {
    const Eigen::RowVectorXd bx =
        Row(x_m / knot_interval_m_ - first_i_, control_points_.cols(), dx);
    const Eigen::RowVectorXd by =
        Row(y_m / knot_interval_m_ - first_j_, control_points_.rows(), dy);
    return (by * control_points_ * bx.transpose()).value() / std::pow(knot_interval_m_, dx + dy);
  }

 private:
  using Spline1d = Eigen::Spline<double, 1, 3>;

  // Derivative of order `order` of all basis functions at u, in units of knots; basis function n is
  // centred at n.
  static Eigen::RowVectorXd Row(double u, Eigen::Index count, int order) {
    Spline1d::KnotVectorType knots(count + 4);
    for (Eigen::Index n = 0; n < knots.size(); ++n) knots(n) = static_cast<double>(n) - 2;
    Eigen::RowVectorXd row = Eigen::RowVectorXd::Zero(count);
    const Eigen::Index span = Spline1d::Span(u, 3, knots);
    const auto derivatives = Spline1d::BasisFunctionDerivatives(u, 3, 3, knots);
    for (int k = 0; k < 4; ++k) row(span - 3 + k) = derivatives(order, k);
    return row;
  }

  Eigen::MatrixXd control_points_;
  int first_i_;
  int first_j_;
  double knot_interval_m_;
};

class SurfaceAgainstEigen : public testing::TestWithParam<double> {};

TEST_P(SurfaceAgainstEigen, ValueGradientAndHessianAgree) {
  // Four tiles around the origin: cells of every position relative to tile borders and signs.
  const double knot_m = GetParam();
  std::mt19937_64 random(7);
  MapWriter map({knot_m, {}});
  Layer& layer = map.AddLayer({"robot", 1}, {1, 1});
  Eigen::MatrixXd control_points(2 * Tile::kSide, 2 * Tile::kSide);
  for (const TileKey key : {TileKey{-1, -1}, TileKey{0, -1}, TileKey{-1, 0}, TileKey{0, 0}}) {
    const Tile tile = RandomTile(random);
    layer.RestoreTile(key, std::make_shared<const StoredTile>(tile), 1);
    for (int k = 0; k < Tile::kSize; ++k) {
      control_points((key.ty + 1) * Tile::kSide + k / Tile::kSide,
                     (key.tx + 1) * Tile::kSide + k % Tile::kSide) =
          tile.control_points[k] / double{kUnitsPerLogOdds};
    }
  }
  const auto view = map.View();
  const EigenSurface reference(control_points, -Tile::kSide, -Tile::kSide, knot_m);

  std::uniform_real_distribution<double> coordinate(-(Tile::kSide - 3) * knot_m,
                                                    (Tile::kSide - 3) * knot_m);
  for (int n = 0; n < 2000; ++n) {
    const double x = coordinate(random);
    const double y = coordinate(random);
    const SurfaceSample sample = view->Evaluate(x, y);
    EXPECT_NEAR(sample.log_odds, reference.Derivative(x, y, 0, 0), 1e-6);
    EXPECT_NEAR(sample.gradient_per_m.x(), reference.Derivative(x, y, 1, 0), 1e-6);
    EXPECT_NEAR(sample.gradient_per_m.y(), reference.Derivative(x, y, 0, 1), 1e-6);
    const Eigen::Matrix2d hessian_per_m2 = view->Hessian(x, y);
    EXPECT_NEAR(hessian_per_m2(0, 0), reference.Derivative(x, y, 2, 0), 1e-6);
    EXPECT_NEAR(hessian_per_m2(1, 1), reference.Derivative(x, y, 0, 2), 1e-6);
    EXPECT_NEAR(hessian_per_m2(0, 1), reference.Derivative(x, y, 1, 1), 1e-6);
    EXPECT_EQ(hessian_per_m2(0, 1), hessian_per_m2(1, 0));
  }
}

INSTANTIATE_TEST_SUITE_P(KnotIntervals, SurfaceAgainstEigen, testing::Values(0.05, 1.0));

TEST(SurfaceTest, StaysWithinTheHullOfItsControlPoints) {
  std::mt19937_64 random(3);
  std::uniform_real_distribution<double> value(-100, 100);
  std::uniform_real_distribution<double> phase(0, 1);
  for (int n = 0; n < 1000; ++n) {
    ControlPatch patch;
    for (int row = 0; row < 4; ++row) {
      for (int column = 0; column < 4; ++column) patch(row, column) = value(random);
    }
    const double s = EvaluatePatch(patch, phase(random), phase(random), 0.05).log_odds;
    EXPECT_GE(s, patch.minCoeff());
    EXPECT_LE(s, patch.maxCoeff());
  }
}

TEST(SurfaceTest, ProbabilityNeitherOverflowsNorLeavesItsRange) {
  EXPECT_EQ(Probability(0), 0.5);
  EXPECT_NEAR(Probability(0.9), 0.7109495, 1e-7);
  EXPECT_EQ(Probability(1e6), 1);
  EXPECT_EQ(Probability(-1e6), 0);
  EXPECT_EQ(Probability(std::numeric_limits<double>::infinity()), 1);
  EXPECT_EQ(Probability(-std::numeric_limits<double>::infinity()), 0);
}

}  // namespace splinemap::surface_test
