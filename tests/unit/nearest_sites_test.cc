#include "lib/distance/nearest_sites.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <random>
#include <tuple>
#include <vector>

namespace splinemap::nearest_sites_test {

// Squared distance in eighths, then y and x.
std::tuple<int64_t, int32_t, int32_t> Rank(const Site& site, int x, int y) {
  const int64_t dx = site.x - 8 * x;
  const int64_t dy = site.y - 8 * y;
  return {dx * dx + dy * dy, site.y, site.x};
}

TEST(NearestSitesTest, AreThoseOfBruteForceInAnyOrder) {
  std::mt19937_64 random(1);
  bool any_hidden = false;
  for (const int extent : {40, 300, 2000, 16'000}) {
    for (const int count : {1, 2, 7, 63, 64, 65, 200, 2000}) {
      std::uniform_int_distribution<int> coordinate(-extent, extent);
      std::vector<Site> sites(count);
      // Few places, so that many are equally near.
      for (Site& site : sites) site = {coordinate(random) | 1, coordinate(random) / 16 * 16 + 1};
      const VertexBlock block{static_cast<int>(random() % 25), static_cast<int>(random() % 25)};
      for (const bool leave_out : {false, true}) {
        std::vector<Site> some = sites;
        std::shuffle(some.begin(), some.end(), random);
        if (leave_out) LeaveOutHidden(some, block);
        any_hidden = any_hidden || some.size() < sites.size() / 4;
        const auto nearest = NearestSites(some, block);
        for (int n = 0; n < VertexBlock::kSize; ++n) {
          const int x = block.x0 + n % VertexBlock::kSide;
          const int y = block.y0 + n / VertexBlock::kSide;
          const Site best = *std::min_element(
              sites.begin(), sites.end(),
              [&](const Site& a, const Site& b) { return Rank(a, x, y) < Rank(b, x, y); });
          ASSERT_EQ(nearest[n], best) << x << " " << y;
        }
      }
    }
  }
  EXPECT_TRUE(any_hidden);
}

TEST(NearestSitesTest, OfNoSitesNoneIsHidden) {
  std::vector<Site> none;
  LeaveOutHidden(none, {0, 0});
  EXPECT_TRUE(none.empty());
}

}  // namespace splinemap::nearest_sites_test
