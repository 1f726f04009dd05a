#pragma once

#include <Eigen/Cholesky>
#include <Eigen/Core>
#include <vector>

namespace splinemap {

// A point that a beam says something about.
struct LabelledPoint {
  Eigen::Vector2d position_m;
  double label = 0;  // 1 occupied, -1 free
};

struct GpParameters {
  double length_m = 0.3;
  double noise_variance = 0.1;  // of the labels; the prior's variance is 1
};

// An occupancy map by Gaussian process regression on labels, as O'Callaghan and Ramos 2012 have it,
// with the Matern 3/2 kernel. Plain: one Cholesky factor of all points. Immutable.
class GpMap {
 public:
  GpMap(std::vector<LabelledPoint> points, const GpParameters& parameters);

  // Mean of the label at a point, and the probability that it is occupied: the mean squashed by the
  // cumulative Gaussian, less the less is known.
  double Mean(const Eigen::Vector2d& point_m) const;
  double Probability(const Eigen::Vector2d& point_m) const;
  // Log of the marginal likelihood of the labels, to choose parameters by.
  double Evidence() const { return evidence_; }

 private:
  Eigen::VectorXd Covariances(const Eigen::Vector2d& point_m) const;

  std::vector<LabelledPoint> points_;
  double length_m_;
  Eigen::LLT<Eigen::MatrixXd> factor_;
  Eigen::VectorXd weights_;
  double evidence_ = 0;
};

}  // namespace splinemap
