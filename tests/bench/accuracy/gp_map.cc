#include "tests/bench/accuracy/gp_map.h"

#include <cmath>
#include <numbers>

namespace splinemap {
namespace {

double Matern32(const Eigen::Vector2d& difference_m, double length_m) {
  const double d = std::numbers::sqrt3 * difference_m.norm() / length_m;
  return (1 + d) * std::exp(-d);
}

double CumulativeGaussian(double z) { return 0.5 * std::erfc(-z / std::numbers::sqrt2); }

}  // namespace

GpMap::GpMap(std::vector<LabelledPoint> points, const GpParameters& parameters)
    : points_(std::move(points)), length_m_(parameters.length_m) {
  const auto n = static_cast<Eigen::Index>(points_.size());
  Eigen::MatrixXd covariance(n, n);
  Eigen::VectorXd labels(n);
  for (Eigen::Index k = 0; k < n; ++k) {
    covariance.col(k) = Covariances(points_[k].position_m);
    covariance(k, k) += parameters.noise_variance;
    labels(k) = points_[k].label;
  }
  factor_.compute(covariance);
  weights_ = factor_.solve(labels);
  const double half_log_determinant = factor_.matrixLLT().diagonal().array().log().sum();
  evidence_ = -0.5 * labels.dot(weights_) - half_log_determinant -
              0.5 * static_cast<double>(n) * std::log(2 * std::numbers::pi);
}

double GpMap::Mean(const Eigen::Vector2d& point_m) const {
  return Covariances(point_m).dot(weights_);
}

double GpMap::Probability(const Eigen::Vector2d& point_m) const {
  const Eigen::VectorXd covariances = Covariances(point_m);
  const double variance = 1 - factor_.matrixL().solve(covariances).squaredNorm();
  return CumulativeGaussian(covariances.dot(weights_) / std::sqrt(1 + variance));
}

Eigen::VectorXd GpMap::Covariances(const Eigen::Vector2d& point_m) const {
  Eigen::VectorXd result(points_.size());
  for (Eigen::Index k = 0; k < result.size(); ++k) {
    result(k) = Matern32(points_[k].position_m - point_m, length_m_);
  }
  return result;
}

}  // namespace splinemap
