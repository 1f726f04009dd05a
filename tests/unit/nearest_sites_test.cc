#include "lib/distance/nearest_sites.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <random>
#include <vector>

namespace splinemap::nearest_sites_test {

int64_t SquaredDistance(const Site& site, int x, int y) {
  const int64_t dx = site.x - 8 * x;
  const int64_t dy = site.y - 8 * y;
  return dx * dx + dy * dy;
}

TEST(NearestSitesTest, AreThoseOfBruteForce) {
  std::mt19937_64 random(1);
  NearestSites nearest_sites;
  bool any_hidden = false;
  for (const int extent : {40, 300, 2000, 16'000, 20'000}) {
    for (const int count : {1, 2, 7, 63, 64, 65, 200, 2000, 6000}) {
      std::uniform_int_distribution<int> coordinate(-extent, extent - 1);
      const VertexBlock block{static_cast<int>(random() % 25), static_cast<int>(random() % 25)};
      std::vector<Site> sites(count);
      // Few places, so that many are equally near; or a ring, so that few are hidden.
      const bool is_ring = random() % 2 == 0;
      for (Site& site : sites) {
        site = {coordinate(random) | 1, coordinate(random) / 16 * 16 + 1};
        if (!is_ring) continue;
        const double angle = coordinate(random);
        site = {static_cast<int>(0.9 * extent * std::cos(angle)) | 1,
                static_cast<int>(0.9 * extent * std::sin(angle)) | 1};
      }
      for (const bool plainly : {false, true}) {
        Sites some;
        for (const Site& site : sites) some.Add(site);
        const auto nearest =
            plainly ? nearest_sites.FindPlainly(some, block) : nearest_sites.Find(some, block);
        any_hidden = any_hidden || some.size < sites.size() / 4;
        for (int n = 0; n < VertexBlock::kSize; ++n) {
          const int x = block.x0 + n % VertexBlock::kSide;
          const int y = block.y0 + n / VertexBlock::kSide;
          const Site first =
              *std::min_element(sites.begin(), sites.end(), [&](const Site& a, const Site& b) {
                return SquaredDistance(a, x, y) < SquaredDistance(b, x, y);
              });
          ASSERT_EQ(nearest[n], first) << x << " " << y << " of " << count << " in " << extent;
        }
      }
    }
  }
  EXPECT_TRUE(any_hidden);
}

TEST(NearestSitesTest, CopiesAreMovedAndTheNearestOfThemIsKnown) {
  Sites from;
  for (int k = 0; k < 30; ++k) from.Add({10 * k + 1, 5 - 2 * k});
  Sites to;
  to.Add({77, 99});
  EXPECT_EQ(AddSites(from, 3, 29, {100, -200}, {120, -200}, to), 11 * 11 + 1);
  ASSERT_EQ(to.size, 27U);
  EXPECT_EQ(to.x[0], 77);
  EXPECT_EQ(to.x[1], 131);
  EXPECT_EQ(to.y[1], -201);
  EXPECT_EQ(to.x[26], 381);
}

}  // namespace splinemap::nearest_sites_test
