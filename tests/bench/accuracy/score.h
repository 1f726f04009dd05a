#pragma once

#include <vector>

namespace splinemap {

// How well the log-odds of a map tell hits from points that are free. All values in log-odds.

// Area under the ROC curve: the chance that a hit scores higher than a free point, ties count half.
// Requires that neither is empty.
double Auc(const std::vector<double>& hits, const std::vector<double>& free);

// Mean over all points of log p(what is there), p kept within [kMinProbability,
// 1 - kMinProbability]: one wrong point of a map that is sure of itself would be infinitely bad.
inline constexpr double kMinProbability = 1e-3;
double MeanLogLikelihood(const std::vector<double>& hits, const std::vector<double>& free);

// The paper's mapping error (37) of a map scaled to -1 (free) .. 1 (occupied), at true hits.
double MappingError(const std::vector<double>& scaled);

// The value at or below which this share of them is, 0 the least, 1 the greatest. Requires that
// there are any.
double Quantile(std::vector<double> values, double share);

}  // namespace splinemap
