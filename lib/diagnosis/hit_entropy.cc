#include "lib/diagnosis/hit_entropy.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstdint>
#include <vector>

namespace splinemap {
namespace {

// The cells are turned by 27 degrees to the axes: a wall along an axis would lie in half as many
// cells where it does not happen to lie on the edge of two rows of them.
constexpr double kSin = 0.4539904997395468;
constexpr double kCos = 0.8910065241883679;

uint64_t CellOf(double coordinate_m) {
  constexpr double kCell_m = 0.05;
  constexpr double kMost = 1 << 30;
  const double place = std::clamp(coordinate_m / kCell_m + 0.5, -kMost, kMost);
  const auto cell = static_cast<int32_t>(place);  // rounds to zero, and has to round down
  return static_cast<uint32_t>(cell - (static_cast<double>(cell) > place ? 1 : 0));
}

// Hits of each cell. Made for one count of a few thousand, of which searches make hundreds.
class CellCounts {
 public:
  explicit CellCounts(size_t max_cells)
      : cells_(std::bit_ceil(max_cells + max_cells / 4 + 1)),
        shift_(64 - std::countr_zero(cells_.size())) {}

  // How many the cell has with this one.
  uint32_t Add(uint64_t cell) {
    constexpr uint64_t kSpread = 0x9e3779b97f4a7c15;  // 2^64 over the golden ratio
    size_t place = cell * kSpread >> shift_;
    while (cells_[place].hits != 0 && cells_[place].cell != cell) {
      place = (place + 1) & (cells_.size() - 1);
    }
    cells_[place].cell = cell;
    return ++cells_[place].hits;
  }

 private:
  struct Cell {
    uint64_t cell = 0;
    uint32_t hits = 0;
  };
  std::vector<Cell> cells_;
  int shift_;
};

}  // namespace

double HitEntropy(absl::Span<const Eigen::Vector2d> hits_world_m) {
  if (hits_world_m.empty()) return 0;
  CellCounts counts(hits_world_m.size());
  std::vector<size_t> cells_with(1);  // by the number of their hits
  for (const Eigen::Vector2d& hit : hits_world_m) {
    const double x_m = kCos * hit.x() - kSin * hit.y();
    const double y_m = kSin * hit.x() + kCos * hit.y();
    const uint32_t hits = counts.Add(CellOf(x_m) << 32 | CellOf(y_m));
    if (hits == cells_with.size()) cells_with.push_back(0);
    ++cells_with[hits];
    if (hits > 1) --cells_with[hits - 1];
  }
  // Summed in the order of counts, so that the order of cells does not show.
  double entropy = 0;
  for (size_t hits = 1; hits < cells_with.size(); ++hits) {
    if (cells_with[hits] == 0) continue;
    const double share = static_cast<double>(hits) / static_cast<double>(hits_world_m.size());
    entropy -= static_cast<double>(cells_with[hits]) * share * std::log(share);
  }
  return std::exp(entropy);
}

}  // namespace splinemap
