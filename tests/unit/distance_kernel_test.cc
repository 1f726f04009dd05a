#include "lib/distance/distance_kernel.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <bit>
#include <random>
#include <string>
#include <tuple>
#include <vector>

namespace splinemap::distance_kernel_test {

const DistanceKernel& Plain() { return DistanceKernels().front(); }

class DistanceKernelTest : public testing::TestWithParam<DistanceKernel> {
 protected:
  int Uniform(int low, int high) { return std::uniform_int_distribution<int>(low, high)(random_); }
  Site RandomSite(int low, int high) {
    const int x = Uniform(low, high);
    return {static_cast<int16_t>(x), static_cast<int16_t>(Uniform(low, high))};
  }
  std::vector<Site> RandomSites(int low, int high) {
    std::vector<Site> sites(Uniform(0, 30));
    for (Site& site : sites) site = RandomSite(low, high);
    return sites;
  }

  const DistanceKernel& kernel_ = GetParam();
  std::mt19937_64 random_{1};
};

std::vector<int32_t> NumbersOf(const NearestOfBlock& nearest) {
  std::vector<int32_t> numbers(std::begin(nearest.ways), std::end(nearest.ways));
  numbers.insert(numbers.end(), std::begin(nearest.squared), std::end(nearest.squared));
  return numbers;
}

TEST_P(DistanceKernelTest, FindsTheNearestSitesThatThePlainOneFinds) {
  int num_added = 0;
  int num_taken_away = 0;
  for (int repetition = 0; repetition < 5000; ++repetition) {
    const VertexBlock block{8 * Uniform(-4, 7), 8 * Uniform(-4, 7)};
    const int far = repetition % 10 == 0 ? 15'000 : 30;  // from the block
    std::array<SiteOffset, Tile::kSize> offsets;
    for (SiteOffset& offset : offsets) {
      const Site way = RandomSite(-far, far);
      const int kind = Uniform(0, 5);
      offset = kind == 0 ? SiteOffset() : kind == 1 ? kLost : SiteOffset{way.x, way.y};
    }
    std::vector<Site> sites = RandomSites(-far, far);
    for (Site& site : sites) {
      site.x = static_cast<int16_t>(site.x + Site::kUnits * block.x0);
      site.y = static_cast<int16_t>(site.y + Site::kUnits * block.y0);
    }
    const int count = static_cast<int>(sites.size());

    for (const bool only_lost : {false, true}) {
      NearestOfBlock nearest{};
      nearest.reach_squared = repetition % 3 == 0 ? 400 : far * far;
      NearestOfBlock expected = nearest;
      kernel_.read(offsets.data(), only_lost, nearest);
      Plain().read(offsets.data(), only_lost, expected);
      ASSERT_EQ(NumbersOf(nearest), NumbersOf(expected));
      const bool is_added = Plain().add(sites.data(), count, block, expected);
      ASSERT_EQ(kernel_.add(sites.data(), count, block, nearest), is_added);
      ASSERT_EQ(NumbersOf(nearest), NumbersOf(expected));
      ASSERT_EQ(kernel_.longest_squared(nearest), Plain().longest_squared(expected));
      std::array<SiteOffset, VertexBlock::kSize> written;
      std::array<SiteOffset, VertexBlock::kSize> expected_written;
      kernel_.write(nearest, written.data());
      Plain().write(expected, expected_written.data());
      ASSERT_EQ(written, expected_written);
      num_added += is_added ? 1 : 0;
    }

    NearestOfBlock nearest{};
    NearestOfBlock expected{};
    kernel_.read(offsets.data(), false, nearest);
    Plain().read(offsets.data(), false, expected);
    ASSERT_EQ(nearest.lost, expected.lost);
    const bool is_any_lost = Plain().take_away(sites.data(), count, block, expected);
    ASSERT_EQ(kernel_.take_away(sites.data(), count, block, nearest), is_any_lost);
    ASSERT_EQ(NumbersOf(nearest), NumbersOf(expected));
    num_taken_away += is_any_lost ? 1 : 0;
  }
  EXPECT_GT(num_added, 1000);
  EXPECT_GT(num_taken_away, 100);
  EXPECT_LT(num_taken_away, 4000);
}

TEST_P(DistanceKernelTest, KeepsTheSitesThatThePlainOneKeeps) {
  int num_kept = 0;
  for (int repetition = 0; repetition < 5000; ++repetition) {
    const std::vector<Site> sites = RandomSites(0, 64);
    const Site low = RandomSite(-64, 64);
    const VertexBox box{low,
                        {static_cast<int16_t>(low.x + Uniform(0, 56)),
                         static_cast<int16_t>(low.y + Uniform(0, 56))}};
    const Site other = RandomSite(-50, 100);
    std::array<Site, 30 + DistanceKernel::kSpareSites> kept;
    std::array<Site, 30 + DistanceKernel::kSpareSites> expected;
    const int count = static_cast<int>(sites.size());
    const int expected_count =
        Plain().keep_not_hidden(sites.data(), count, box, other, expected.data());
    ASSERT_EQ(kernel_.keep_not_hidden(sites.data(), count, box, other, kept.data()),
              expected_count);
    for (int k = 0; k < expected_count; ++k) ASSERT_EQ(kept[k], expected[k]);
    num_kept += expected_count;
  }
  EXPECT_GT(num_kept, 1000);
}

TEST_P(DistanceKernelTest, FindsTheBlocksThatAreNear) {
  int num_near = 0;
  for (int repetition = 0; repetition < 5000; ++repetition) {
    const Site low = RandomSite(-600, 600);
    const VertexBox box{low,
                        {static_cast<int16_t>(low.x + Uniform(0, 64)),
                         static_cast<int16_t>(low.y + Uniform(0, 64))}};
    const int first = Uniform(0, 1);
    const int last = Uniform(56, 63);
    std::array<int32_t, 16> limits;
    uint32_t expected = 0;
    for (int block = 0; block < 16; ++block) {
      const int x0 = 64 * (block % 4);
      const int y0 = 64 * (block / 4);
      const int x = std::max({x0 + first - box.high.x, box.low.x - x0 - last, 0});
      const int y = std::max({y0 + first - box.high.y, box.low.y - y0 - last, 0});
      const int length = Uniform(0, 400);
      limits[block] = Uniform(0, 1) == 0 ? x * x + y * y - Uniform(0, 1) : length * length;
      if (x * x + y * y <= limits[block]) expected |= 1u << block;
    }
    ASSERT_EQ(kernel_.blocks_near(box, first, last, limits.data()), expected);
    num_near += std::popcount(expected);
  }
  EXPECT_GT(num_near, 10'000);
  EXPECT_LT(num_near, 70'000);
}

TEST_P(DistanceKernelTest, BoundsCellsAsThePlainOneDoes) {
  constexpr int kStride = Tile::kSide;
  uint32_t all_high = 0;
  for (int repetition = 0; repetition < 5000; ++repetition) {
    std::array<ControlPoint, 4 * kStride> rows;
    for (ControlPoint& c : rows) {
      c = static_cast<ControlPoint>(repetition % 2 == 0 ? random_() : Uniform(-300, 300));
    }
    const ControlPoint* const first = &rows[Uniform(0, kStride - 11)];
    CellRanges ranges;
    CellRanges expected;
    kernel_.find_ranges(first, kStride, ranges);
    Plain().find_ranges(first, kStride, expected);
    for (int k = 0; k < CellRanges::kCells; ++k) {
      ASSERT_EQ(std::tuple(ranges.least[k], ranges.greatest[k], ranges.bend[k]),
                std::tuple(expected.least[k], expected.greatest[k], expected.bend[k]));
    }
    const double higher = kNetUnits * Uniform(-300, 300);
    const double high = higher - kNetUnits * Uniform(0, 200);
    const SquaresWithCorner corners = kernel_.find_corners(rows.data(), high, higher);
    const SquaresWithCorner expected_corners = Plain().find_corners(rows.data(), high, higher);
    ASSERT_EQ(corners.high, expected_corners.high);
    ASSERT_EQ(corners.higher, expected_corners.higher);
    all_high |= corners.high;
    const int x = Uniform(0, 3);
    const int y = Uniform(0, 3);
    std::array<double, 16> net;
    kernel_.find_net(rows.data(), x, y, net.data());
    for (int k = 0; k < 16; ++k) {
      double point = 0;
      for (int c = 0; c < 16; ++c) {
        point += kNetWeights[c % 4][3 * x + k % 4] * kNetWeights[c / 4][3 * y + k / 4] * rows[c];
      }
      ASSERT_EQ(net[k], point);
    }
  }
  EXPECT_EQ(all_high, 0xFFFFu);
}

INSTANTIATE_TEST_SUITE_P(, DistanceKernelTest, testing::ValuesIn(DistanceKernels()),
                         [](const auto& of) { return std::string(of.param.name); });

}  // namespace splinemap::distance_kernel_test
