#include "lib/distance/nearest_sites.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <random>
#include <tuple>
#include <vector>

#include "splinemap/tile.h"

namespace splinemap::nearest_sites_test {

int64_t SquaredDistance(const Site& site, int x, int y) {
  const int64_t dx = site.x - 8 * x;
  const int64_t dy = site.y - 8 * y;
  return dx * dx + dy * dy;
}

Site SiteAt(int x, int y) { return {static_cast<int16_t>(x), static_cast<int16_t>(y)}; }

// The nearest, of those that are equally near that of the least y, of these that of the least x.
Site NearestOf(const std::vector<Site>& sites, int x, int y) {
  return *std::min_element(sites.begin(), sites.end(), [&](const Site& a, const Site& b) {
    return std::tuple(SquaredDistance(a, x, y), a.y, a.x) <
           std::tuple(SquaredDistance(b, x, y), b.y, b.x);
  });
}

SiteOffset OffsetTo(const Site& site, const VertexBlock& block, int vertex) {
  return {static_cast<int16_t>(site.x - 8 * (block.x0 + vertex % 8)),
          static_cast<int16_t>(site.y - 8 * (block.y0 + vertex / 8))};
}

// A block in a tile, of which vertices have what a test says.
class OffsetsOfBlock {
 public:
  const SiteOffset* data() const { return &tile_[IndexInTile(8, 16)]; }
  const SiteOffset& At(int vertex) const { return data()[Tile::kSide * (vertex / 8) + vertex % 8]; }
  SiteOffset& At(int vertex) { return tile_[IndexInTile(8 + vertex % 8, 16 + vertex / 8)]; }
  void FillWithLost() { tile_.fill(kLost); }
  // Odd ones, some vertices have nothing.
  void FillAtRandom(std::mt19937_64& random) {
    std::uniform_int_distribution<int> offset(-20, 20);
    for (SiteOffset& at : tile_) {
      const Site way = SiteAt(2 * offset(random) + 1, 2 * offset(random) + 1);
      at = random() % 4 == 0 ? SiteOffset() : SiteOffset{way.x, way.y};
    }
  }

 private:
  std::array<SiteOffset, Tile::kSize> tile_;
};

TEST(NearestSitesTest, AreThoseOfBruteForceInWhateverOrderTheyCome) {
  std::mt19937_64 random(1);
  int num_ties = 0;
  for (int n = 0; n < 20 * 4; ++n) {
    const int extent = std::array{40, 300, 2000, 16'000}[n % 4];
    for (const int count : {1, 2, 7, 63, 64, 65, 200, 1000}) {
      std::uniform_int_distribution<int> coordinate(-extent, extent - 1);
      const VertexBlock block{static_cast<int>(random() % 25), static_cast<int>(random() % 25)};
      std::vector<Site> sites(count);
      // Few places, so that many are equally near; or a ring, so that all are near something.
      const bool is_ring = random() % 2 == 0;
      for (Site& site : sites) {
        site = SiteAt(coordinate(random) | 1, coordinate(random) / 16 * 16 + 1);
        if (!is_ring) continue;
        const double angle = coordinate(random);
        site = SiteAt(static_cast<int>(0.9 * extent * std::cos(angle)) | 1,
                      static_cast<int>(0.9 * extent * std::sin(angle)) | 1);
      }
      OffsetsOfBlock offsets;
      offsets.FillWithLost();
      NearestSites nearest(NearestSites::Of::kLostOnes, offsets.data(), 2'000'000'000);
      std::shuffle(sites.begin(), sites.end(), random);
      const size_t half = sites.size() / 2;
      for (const auto& some : {absl::MakeConstSpan(sites).subspan(half),
                               absl::MakeConstSpan(sites).subspan(0, half)}) {
        nearest.Add(some, block);
      }
      int64_t longest = 0;
      for (int vertex = 0; vertex < VertexBlock::kSize; ++vertex) {
        const int x = block.x0 + vertex % 8;
        const int y = block.y0 + vertex / 8;
        const Site expected = NearestOf(sites, x, y);
        ASSERT_EQ(nearest.OffsetOf(vertex), OffsetTo(expected, block, vertex));
        ASSERT_EQ(nearest.Offsets()[vertex], nearest.OffsetOf(vertex));
        longest = std::max(longest, SquaredDistance(expected, x, y));
        num_ties += std::any_of(sites.begin(), sites.end(), [&](const Site& site) {
          return site != expected && SquaredDistance(site, x, y) == SquaredDistance(expected, x, y);
        });
      }
      ASSERT_EQ(nearest.LongestSquared(), longest);
    }
  }
  EXPECT_GT(num_ties, 50);
}

TEST(NearestSitesTest, OnlyThoseThatCannotBeTheNearestAreHidden) {
  std::mt19937_64 random(1);
  std::uniform_int_distribution<int> coordinate(-60, 90);
  SomeSites some_sites;
  int num_hidden = 0;
  int num_kept = 0;
  for (int n = 0; n < 3000; ++n) {
    std::vector<Site> sites;
    for (int k = 0; k < static_cast<int>(random() % 30); ++k) {
      sites.push_back(SiteAt(2 * coordinate(random) + 1, 2 * coordinate(random) + 1));
    }
    const int away = n % 2 == 0 ? 0 : 1990;  // as far as a field reaches
    const Site low =
        SiteAt(8 * (away + static_cast<int>(random() % 5)), 8 * static_cast<int>(random() % 5));
    const VertexBox box{low, SiteAt(low.x + 8 * static_cast<int>(random() % 8),
                                    low.y + 8 * static_cast<int>(random() % 8))};
    const Site other = SiteAt(coordinate(random) | 1, coordinate(random) | 1);
    const auto kept = some_sites.NotHidden(sites, box, other);
    std::vector<Site> expected;
    for (const Site& site : sites) {
      bool is_as_near = false;
      for (const int x : {box.low.x, box.high.x}) {
        for (const int y : {box.low.y, box.high.y}) {
          is_as_near = is_as_near ||
                       SquaredDistance(site, x / 8, y / 8) <= SquaredDistance(other, x / 8, y / 8);
        }
      }
      if (is_as_near) expected.push_back(site);
    }
    ASSERT_EQ(std::vector<Site>(kept.begin(), kept.end()), expected);
    num_kept += static_cast<int>(kept.size());
    num_hidden += static_cast<int>(sites.size() - kept.size());
  }
  EXPECT_GT(num_kept, 1000);
  EXPECT_GT(num_hidden, 1000);
}

TEST(NearestSitesTest, VerticesLoseASiteWhereTheirOffsetPointsToIt) {
  std::mt19937_64 random(1);
  std::uniform_int_distribution<int> coordinate(-40, 40);
  const VertexBlock block{-32, 64};
  int num_lost = 0;
  for (int n = 0; n < 20'000; ++n) {
    OffsetsOfBlock offsets;
    offsets.FillAtRandom(random);
    std::vector<Site> sites;
    for (int k = 0; k < 3; ++k) {
      sites.push_back(SiteAt(-256 + 2 * coordinate(random) + 1, 512 + 2 * coordinate(random) + 1));
    }
    constexpr int kReachSquared = 4000;  // more than that of any
    NearestSites nearest(NearestSites::Of::kAllVertices, offsets.data(), kReachSquared);
    BlockOffsets expected;
    int longest = 0;
    for (int vertex = 0; vertex < VertexBlock::kSize; ++vertex) {
      const SiteOffset has = offsets.At(vertex);
      expected[vertex] = has;
      for (const Site& site : sites) {
        if (OffsetTo(site, block, vertex) == has) expected[vertex] = kLost;
      }
      const bool has_any = expected[vertex] != SiteOffset() && expected[vertex] != kLost;
      longest = std::max(longest, has_any ? has.x * has.x + has.y * has.y : kReachSquared);
    }
    const bool is_any_lost = std::find(expected.begin(), expected.end(), kLost) != expected.end();
    ASSERT_EQ(nearest.TakeAway(sites, block), is_any_lost);
    ASSERT_EQ(nearest.Offsets(), expected);
    ASSERT_EQ(nearest.LongestSquared(), longest);
    num_lost += is_any_lost ? 1 : 0;
  }
  EXPECT_GT(num_lost, 100);
  EXPECT_LT(num_lost, 1000);
}

TEST(NearestSitesTest, SitesAreTakenWhereTheyAreNearer) {
  std::mt19937_64 random(1);
  std::uniform_int_distribution<int> coordinate(-60, 90);
  const VertexBlock block{-32, 64};
  int num_taken = 0;
  int num_nothing = 0;
  for (int n = 0; n < 6000; ++n) {
    OffsetsOfBlock offsets;
    offsets.FillAtRandom(random);
    for (int k = 0; k < 9; ++k) offsets.At(static_cast<int>(random() % 64)) = kLost;
    const int reach_squared = 30 * 30 + static_cast<int>(random() % 500);
    std::vector<Site> sites;
    for (int k = 0; k < static_cast<int>(random() % 3); ++k) {
      sites.push_back(SiteAt(-256 + 2 * coordinate(random) + 1, 512 + 2 * coordinate(random) + 1));
    }
    for (const auto of : {NearestSites::Of::kAllVertices, NearestSites::Of::kLostOnes}) {
      NearestSites nearest(of, offsets.data(), reach_squared);
      for (int vertex = 0; vertex < VertexBlock::kSize; ++vertex) {
        ASSERT_EQ((nearest.LostOnes() >> vertex & 1) != 0, offsets.At(vertex) == kLost);
      }
      const bool is_taken = nearest.Add(sites, block);
      (is_taken ? num_taken : num_nothing) += 1;
      bool is_taken_expected = false;
      int64_t longest = 0;
      for (int vertex = 0; vertex < VertexBlock::kSize; ++vertex) {
        SiteOffset has = offsets.At(vertex);
        const bool is_lost = has == kLost;
        if (is_lost) has = SiteOffset();
        const auto length = [&] {
          return has == SiteOffset() ? reach_squared + 1 : has.x * has.x + has.y * has.y;
        };
        for (const Site& site : sites) {
          if (of == NearestSites::Of::kLostOnes && !is_lost) continue;
          const SiteOffset way = OffsetTo(site, block, vertex);
          if (std::tuple(way.x * way.x + way.y * way.y, way.y, way.x) <
              std::tuple(length(), has.y, has.x)) {
            has = way;
            is_taken_expected = true;
          }
        }
        ASSERT_EQ(nearest.OffsetOf(vertex), has);
        if (of == NearestSites::Of::kAllVertices || is_lost) {
          longest = std::max<int64_t>(longest, std::min(length(), reach_squared));
        }
      }
      ASSERT_EQ(is_taken, is_taken_expected);
      ASSERT_EQ(nearest.LongestSquared(), longest);
    }
  }
  EXPECT_GT(num_taken, 100);
  EXPECT_GT(num_nothing, 100);
}

}  // namespace splinemap::nearest_sites_test
