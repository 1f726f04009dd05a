#include "lib/distance/nearest_sites.h"

#include <algorithm>
#include <cstdlib>
#include <limits>

namespace splinemap {
namespace {

typedef int32_t Integers4 __attribute__((vector_size(16)));

int32_t SquaredDistance(const Site& a, const Site& b) {
  return (a.x - b.x) * (a.x - b.x) + (a.y - b.y) * (a.y - b.y);
}

}  // namespace

void LeaveOutHidden(std::vector<Site>& sites, const VertexBlock& block) {
  if (sites.empty()) return;
  constexpr int32_t kHalf = Site::kUnits * (VertexBlock::kSide - 1) / 2;
  const Site centre{Site::kUnits * block.x0 + kHalf, Site::kUnits * block.y0 + kHalf};
  Site best = sites[0];
  int32_t least = std::numeric_limits<int32_t>::max();
  for (const Site& site : sites) {
    const int32_t squared = SquaredDistance(site, centre);
    if (squared < least) best = site;
    least = std::min(squared, least);
  }
  // |v - site|^2 - |v - best|^2 is linear in v: over the block it is at most so much less than at
  // the centre.
  size_t num_kept = 0;
  for (const Site site : sites) {
    const int32_t slack = 2 * kHalf * (std::abs(site.x - best.x) + std::abs(site.y - best.y));
    sites[num_kept] = site;
    num_kept += SquaredDistance(site, centre) - least <= slack ? 1 : 0;
  }
  sites.resize(num_kept);
}

std::array<Site, VertexBlock::kSize> NearestSites(std::vector<Site>& sites,
                                                  const VertexBlock& block) {
  std::sort(sites.begin(), sites.end(),
            [](const Site& a, const Site& b) { return a.y != b.y ? a.y < b.y : a.x < b.x; });
  // Four vertices of a row at once, and few sites, whose squares stay in the fastest cache.
  constexpr int kFours = VertexBlock::kSize / 4;
  constexpr size_t kChunk = 64;
  std::array<Integers4, kFours> least;
  std::array<Integers4, kFours> best;
  least.fill(Integers4{} + std::numeric_limits<int32_t>::max());
  best.fill(Integers4{});
  std::array<std::array<Integers4, kChunk>, 2> squares_x;
  for (size_t begin = 0; begin < sites.size(); begin += kChunk) {
    const size_t count = std::min(kChunk, sites.size() - begin);
    for (int half = 0; half < 2; ++half) {
      const Integers4 x = Site::kUnits * (block.x0 + 4 * half + Integers4{0, 1, 2, 3});
      for (size_t k = 0; k < count; ++k) {
        squares_x[half][k] = (x - sites[begin + k].x) * (x - sites[begin + k].x);
      }
    }
    for (int four = 0; four < kFours; ++four) {
      const int32_t y = Site::kUnits * (block.y0 + four / 2);
      Integers4 least_of_four = least[four];
      Integers4 best_of_four = best[four];
      for (size_t k = 0; k < count; ++k) {
        const int32_t dy = y - sites[begin + k].y;
        const Integers4 squared = squares_x[four % 2][k] + dy * dy;
        const Integers4 is_less = squared < least_of_four;
        least_of_four = is_less ? squared : least_of_four;
        best_of_four = is_less ? Integers4{} + static_cast<int32_t>(begin + k) : best_of_four;
      }
      least[four] = least_of_four;
      best[four] = best_of_four;
    }
  }
  std::array<Site, VertexBlock::kSize> nearest;
  for (int n = 0; n < VertexBlock::kSize; ++n) nearest[n] = sites[best[n / 4][n % 4]];
  return nearest;
}

}  // namespace splinemap
