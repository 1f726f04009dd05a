#include "lib/diagnosis/hit_entropy.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <vector>

#include "absl/container/flat_hash_map.h"

namespace splinemap {
namespace {

// The cells are turned by 27 degrees to the axes: a wall along an axis would lie in half as many
// cells where it does not happen to lie on the edge of two rows of them.
constexpr double kSin = 0.4539904997395468;
constexpr double kCos = 0.8910065241883679;

uint64_t CellOf(double coordinate_m) {
  constexpr double kCell_m = 0.05;
  constexpr double kMost = 1 << 30;
  const double cell = std::clamp(std::floor(coordinate_m / kCell_m + 0.5), -kMost, kMost);
  return static_cast<uint32_t>(static_cast<int32_t>(cell));
}

}  // namespace

double HitEntropy(absl::Span<const Eigen::Vector2d> hits_world_m) {
  if (hits_world_m.empty()) return 0;
  absl::flat_hash_map<uint64_t, uint32_t> hits_in;
  hits_in.reserve(hits_world_m.size() / 4);
  uint32_t most = 0;
  for (const Eigen::Vector2d& hit : hits_world_m) {
    const double x_m = kCos * hit.x() - kSin * hit.y();
    const double y_m = kSin * hit.x() + kCos * hit.y();
    most = std::max(most, ++hits_in[CellOf(x_m) << 32 | CellOf(y_m)]);
  }
  // Summed in the order of counts, so that the order of cells does not show.
  std::vector<size_t> cells_with(size_t{most} + 1);
  for (const auto& [cell, hits] : hits_in) ++cells_with[hits];
  double entropy = 0;
  for (size_t hits = 1; hits <= most; ++hits) {
    if (cells_with[hits] == 0) continue;
    const double share = static_cast<double>(hits) / static_cast<double>(hits_world_m.size());
    entropy -= static_cast<double>(cells_with[hits]) * share * std::log(share);
  }
  return std::exp(entropy);
}

}  // namespace splinemap
