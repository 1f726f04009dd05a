#include "lib/distance/nearest_sites.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <random>
#include <vector>

#include "splinemap/tile.h"

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

// A block in a tile, some of whose vertices have nothing.
class OffsetsOfBlock {
 public:
  explicit OffsetsOfBlock(std::mt19937_64& random) {
    std::uniform_int_distribution<int> offset(-20, 20);
    for (SiteOffset& at : tile_) {
      if (random() % 4 == 0) continue;
      at = {static_cast<int16_t>(2 * offset(random) + 1),
            static_cast<int16_t>(2 * offset(random) + 1)};
    }
  }
  const SiteOffset* data() const { return &tile_[IndexInTile(8, 16)]; }
  const SiteOffset& At(int x, int y) const { return data()[Tile::kSide * y + x]; }

 private:
  std::array<SiteOffset, Tile::kSize> tile_;
};

int SquaredLength(const SiteOffset& offset) { return offset.x * offset.x + offset.y * offset.y; }

TEST(NearestSitesTest, VerticesHaveASiteWhereTheirOffsetPointsToIt) {
  std::mt19937_64 random(1);
  std::uniform_int_distribution<int> coordinate(-40, 40);
  const VertexBlock block{-32, 64};
  int num_had = 0;
  for (int n = 0; n < 20'000; ++n) {
    const OffsetsOfBlock offsets(random);
    std::vector<Site> sites;
    for (int k = 0; k < 3; ++k) {
      sites.push_back({-256 + 2 * coordinate(random) + 1, 512 + 2 * coordinate(random) + 1});
    }
    bool has_any = false;
    for (const Site& site : sites) {
      for (int y = 0; y < 8; ++y) {
        for (int x = 0; x < 8; ++x) {
          const SiteOffset to_site{static_cast<int16_t>(site.x - 8 * (block.x0 + x)),
                                   static_cast<int16_t>(site.y - 8 * (block.y0 + y))};
          has_any = has_any || to_site == offsets.At(x, y);
        }
      }
    }
    ASSERT_EQ(HasAny(sites, block, offsets.data()), has_any);
    num_had += has_any ? 1 : 0;
  }
  EXPECT_GT(num_had, 100);
  EXPECT_LT(num_had, 1000);
}

TEST(NearestSitesTest, SitesThatCameAreTakenWhereTheyAreNearer) {
  std::mt19937_64 random(1);
  std::uniform_int_distribution<int> coordinate(-60, 90);
  const VertexBlock block{-32, 64};
  int num_as_near = 0;
  int num_nearer = 0;
  int num_nothing = 0;
  for (int n = 0; n < 6000; ++n) {
    const OffsetsOfBlock offsets(random);
    const int reach_squared = 30 * 30 + static_cast<int>(random() % 500);
    std::vector<Site> sites;
    for (int k = 0; k < static_cast<int>(random() % 3); ++k) {
      sites.push_back({-256 + 2 * coordinate(random) + 1, 512 + 2 * coordinate(random) + 1});
    }
    const WithSites result = AddToBlock(sites, block, offsets.data(), reach_squared);
    bool is_any_as_near = false;
    bool is_any_nearer = false;
    int longest = 0;
    bool is_same = true;
    for (int y = 0; y < 8; ++y) {
      for (int x = 0; x < 8; ++x) {
        SiteOffset best = offsets.At(x, y);
        int least = best == SiteOffset() ? reach_squared + 1 : SquaredLength(best);
        for (const Site& site : sites) {
          const SiteOffset to_site{static_cast<int16_t>(site.x - 8 * (block.x0 + x)),
                                   static_cast<int16_t>(site.y - 8 * (block.y0 + y))};
          is_any_as_near = is_any_as_near || SquaredLength(to_site) == least;
          if (SquaredLength(to_site) >= least) continue;
          is_any_nearer = true;
          least = SquaredLength(to_site);
          best = to_site;
        }
        longest = std::max(longest, std::min(least, reach_squared));
        is_same = is_same && best == result.offsets[8 * y + x];
      }
    }
    ASSERT_EQ(result.is_any_as_near, is_any_as_near);
    if (is_any_as_near) {
      ++num_as_near;
      continue;
    }
    ASSERT_EQ(result.is_any_nearer, is_any_nearer);
    (is_any_nearer ? num_nearer : num_nothing) += 1;
    if (!is_any_nearer) continue;
    ASSERT_TRUE(is_same);
    ASSERT_EQ(result.longest_squared, longest);
  }
  EXPECT_GT(num_as_near, 100);
  EXPECT_GT(num_nearer, 100);
  EXPECT_GT(num_nothing, 100);
}

}  // namespace splinemap::nearest_sites_test
