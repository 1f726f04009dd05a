#include "lib/diagnosis/hit_entropy.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <utility>
#include <vector>

namespace splinemap {

double HitEntropy(absl::Span<const Eigen::Vector2d> hits_world_m) {
  constexpr double kCell_m = 0.05;
  std::vector<std::pair<int64_t, int64_t>> cells;
  cells.reserve(hits_world_m.size());
  for (const Eigen::Vector2d& hit : hits_world_m) {
    cells.emplace_back(std::llround(hit.x() / kCell_m), std::llround(hit.y() / kCell_m));
  }
  std::sort(cells.begin(), cells.end());
  double entropy = 0;
  for (auto first = cells.begin(); first != cells.end();) {
    const auto last = std::upper_bound(first, cells.end(), *first);
    const double share = static_cast<double>(last - first) / static_cast<double>(cells.size());
    entropy -= share * std::log(share);
    first = last;
  }
  return cells.empty() ? 0 : std::exp(entropy);
}

}  // namespace splinemap
