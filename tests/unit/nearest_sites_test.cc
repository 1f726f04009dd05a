#include "lib/query/nearest_sites.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <map>
#include <random>
#include <tuple>
#include <utility>
#include <vector>

namespace splinemap {
namespace {

// Squared distance in eighths, then y and x.
std::tuple<int64_t, int32_t, int32_t> Rank(const Site& site, int x, int y) {
  const int64_t dx = site.x - 8 * x;
  const int64_t dy = site.y - 8 * y;
  return {dx * dx + dy * dy, site.y, site.x};
}

TEST(NearestSitesTest, AreThoseOfBruteForceInAnyOrder) {
  std::mt19937_64 random(1);
  NearestSites nearest;
  for (const int extent : {40, 300, 2000, 16'000}) {
    for (const int count : {1, 2, 7, 100, 2000}) {
      std::uniform_int_distribution<int> coordinate(-extent, extent);
      std::vector<Site> sites(count);
      // Few places, so that many are equally near.
      for (Site& site : sites) site = {coordinate(random) | 1, coordinate(random) / 16 * 16 + 1};
      const VertexBox box{static_cast<int>(random() % 8), static_cast<int>(random() % 8),
                          8 + static_cast<int>(random() % 25), 8 + static_cast<int>(random() % 25)};
      std::vector<Site> fewer = sites;
      std::shuffle(fewer.begin(), fewer.end(), random);
      NearestSites::LeaveOut(fewer, box);
      EXPECT_TRUE(count < 2000 || fewer.size() < sites.size());
      std::map<std::pair<int, int>, Site> found;
      nearest.Find(fewer, box, [&](int x, int y, const Site& site) {
        EXPECT_TRUE(found.insert({{x, y}, site}).second) << "twice";
      });
      EXPECT_EQ(found.size(), (box.x1 - box.x0 + 1) * (box.y1 - box.y0 + 1));
      for (const auto& [vertex, site] : found) {
        const auto [x, y] = vertex;
        const Site best = *std::min_element(
            sites.begin(), sites.end(),
            [&](const Site& a, const Site& b) { return Rank(a, x, y) < Rank(b, x, y); });
        ASSERT_EQ(Rank(site, x, y), Rank(best, x, y)) << x << " " << y;
      }
    }
  }
}

TEST(NearestSitesTest, WithoutSitesNothingIsNearest) {
  NearestSites nearest;
  std::vector<Site> none;
  NearestSites::LeaveOut(none, {0, 0, 32, 32});
  nearest.Find(none, {0, 0, 32, 32}, [](int, int, const Site&) { FAIL(); });
}

}  // namespace
}  // namespace splinemap
