#include "tests/bench/accuracy/score.h"

#include <algorithm>
#include <cmath>
#include <cstddef>

#include "splinemap/surface.h"

namespace splinemap {
namespace {

double LogLikelihood(double log_odds_of_truth) {
  return std::log(std::clamp(Probability(log_odds_of_truth), kMinProbability, 1 - kMinProbability));
}

}  // namespace

double Auc(const std::vector<double>& hits, const std::vector<double>& free) {
  std::vector<double> sorted = free;
  std::sort(sorted.begin(), sorted.end());
  double wins = 0;
  for (const double hit : hits) {
    const auto [equal, greater] = std::equal_range(sorted.begin(), sorted.end(), hit);
    wins += 0.5 * static_cast<double>((equal - sorted.begin()) + (greater - sorted.begin()));
  }
  return wins / (static_cast<double>(hits.size()) * static_cast<double>(free.size()));
}

double MeanLogLikelihood(const std::vector<double>& hits, const std::vector<double>& free) {
  double sum = 0;
  for (const double s : hits) sum += LogLikelihood(s);
  for (const double s : free) sum += LogLikelihood(-s);
  return sum / static_cast<double>(hits.size() + free.size());
}

double MappingError(const std::vector<double>& scaled) {
  double sum = 0;
  for (const double m : scaled) sum += (1 - m) * (1 - m);
  return sum;
}

double Quantile(std::vector<double> values, double share) {
  const auto index = static_cast<std::ptrdiff_t>(share * static_cast<double>(values.size() - 1));
  std::nth_element(values.begin(), values.begin() + index, values.end());
  return values[index];
}

}  // namespace splinemap
