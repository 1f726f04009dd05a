#include "lib/mapping/scan_scratch.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cstddef>
#include <vector>

#include "splinemap/map_view.h"

namespace splinemap::scan_scratch_test {

constexpr int kUnit = 1 << ScanScratch::kFractionBits;  // one unit of a control point
constexpr ControlLimits kLimits;

class ScanScratchTest : public testing::Test {
 protected:
  ControlPoint At(int i, int j) const {
    const auto tile = FindTile(layer_.tiles(), TileOf(i, j));
    return tile == nullptr ? 0 : tile->control_points[IndexInTile(i, j)];
  }
  void Commit() { scratch_.CommitTo(layer_, kLimits); }

  Layer layer_{LayerId{"robot", 1}, SessionId{1, 1}};
  ScanScratch scratch_;
};

TEST_F(ScanScratchTest, RoundsOncePerControlPointToTheNearest) {
  scratch_.At(0, 0) = 10 * kUnit + kUnit / 2 - 1;
  scratch_.At(1, 0) = -10 * kUnit - kUnit / 2 - 1;
  scratch_.At(-1, 70) = 3 * kUnit;
  Commit();
  EXPECT_EQ(At(0, 0), 10);
  EXPECT_EQ(At(1, 0), -11);
  EXPECT_EQ(At(-1, 70), 3);
}

TEST_F(ScanScratchTest, HalvesRoundToEvenSoThatNothingDrifts) {
  for (int k = -6; k < 6; ++k) scratch_.At(k, 0) = k * kUnit + kUnit / 2;
  Commit();
  int sum = 0;
  for (int k = -6; k < 6; ++k) {
    EXPECT_EQ(At(k, 0) % 2, 0) << k;
    sum += At(k, 0);
  }
  EXPECT_EQ(sum, 0);
}

TEST_F(ScanScratchTest, WhatRoundsToZeroLeavesNoTrace) {
  scratch_.At(5, 5) = kUnit / 2;  // to even: 0
  Commit();
  EXPECT_EQ(layer_.tiles().size(), 0u);
  EXPECT_EQ(layer_.revision(), 1u);
}

TEST_F(ScanScratchTest, ASumThatCancelsInTheLayerStaysTouched) {
  scratch_.At(0, 0) = 7 * kUnit;
  Commit();
  scratch_.At(0, 0) = -7 * kUnit;
  Commit();
  EXPECT_EQ(At(0, 0), 1);
}

TEST_F(ScanScratchTest, SaturatesAtTheLimits) {
  for (int n = 0; n < 3; ++n) {
    scratch_.At(0, 0) = 20000 * kUnit;
    scratch_.At(1, 0) = -20000 * kUnit;
    Commit();
  }
  EXPECT_EQ(At(0, 0), kLimits.max);
  EXPECT_EQ(At(1, 0), kLimits.min);
}

TEST_F(ScanScratchTest, IsEmptyAfterACommit) {
  scratch_.At(0, 0) = kUnit;
  Commit();
  Commit();
  EXPECT_EQ(At(0, 0), 1);
  EXPECT_EQ(layer_.tiles().RevisionOf({0, 0}), 1u);
  EXPECT_EQ(layer_.revision(), 2u);
  EXPECT_EQ(scratch_.At(0, 0), 0);
}

using FreeBlock = SumBlock<uint16_t>;

// Within one block. From the first row on they lean more and more to either side.
std::vector<FreeLine> FanOfLines() {
  std::vector<FreeLine> lines;
  for (int slope = -LineTable::kSlopesPerOne; slope <= LineTable::kSlopesPerOne; ++slope) {
    const int32_t columns_per_row = slope * ((1 << FreeLine::kFractionBits) / 64);
    lines.push_back({.column = (int64_t{60} << FreeLine::kFractionBits) + slope * 12345,
                     .columns_per_row = columns_per_row,
                     .first_row = 3,
                     .rows = 20 + (slope & 31),
                     .slope = slope + LineTable::kSlopesPerOne});
  }
  return lines;
}

// What a list of lines adds to the rows of one block, capped once at the end.
std::vector<uint16_t> CappedSums(const std::vector<FreeLine>& lines, const uint16_t* table) {
  using Table = FreeLineTable<uint16_t>;
  std::vector<int64_t> sums(FreeBlock::kRows * FreeBlock::kStride);
  for (const FreeLine& line : lines) {
    for (int n = 0; n < line.rows; ++n) {
      const int64_t column = line.column + int64_t{line.columns_per_row} * (n & ~1);
      const int64_t phase = (column >> (FreeLine::kFractionBits - Table::kPhaseBits)) & 31;
      const uint16_t* row = table + ptrdiff_t{line.slope} * Table::kSumsPerSlope +
                            (phase * 2 + n % 2) * Table::kWidth;
      for (int k = 0; k < Table::kWidth; ++k) {
        sums[(line.first_row + n) * FreeBlock::kStride + (column >> FreeLine::kFractionBits) + k] +=
            row[k];
      }
    }
  }
  std::vector<uint16_t> capped(sums.size());
  std::ranges::transform(sums, capped.begin(), [](int64_t sum) {
    return static_cast<uint16_t>(std::min<int64_t>(sum, 65535));
  });
  return capped;
}

TEST(FreeWeightsTest, EveryKernelSaturatesAsAPlainSumThatIsCapped) {
  const FreeLineTable<uint16_t> table(SignedDistance::kWeightPerKnot, Footprint::kBasis);
  std::vector<FreeLine> lines;
  for (int n = 0; n < 40; ++n) {
    for (const FreeLine& line : FanOfLines()) lines.push_back(line);
  }
  const std::vector<uint16_t> expected = CappedSums(lines, table.data());
  EXPECT_GT(std::ranges::count(expected, 65535), 100);
  EXPECT_GT(std::ranges::count_if(expected, [](int sum) { return sum > 0 && sum < 65535; }), 100);
  for (const ScanKernel& kernel : ScanKernels()) {
    SumPlane<uint16_t> plane;
    kernel.add_free_lines(lines.data(), lines.size(), table.data(), plane);
    ASSERT_EQ(plane.size(), 1u) << kernel.name;
    EXPECT_TRUE(std::ranges::equal(expected, absl::MakeSpan(plane.block(0).sums, expected.size())))
        << kernel.name;
  }
}

TEST(FreeWeightsTest, SumsThatAreMovedTogetherSaturateInEveryKernel) {
  for (const ScanKernel& kernel : ScanKernels()) {
    SCOPED_TRACE(kernel.name);
    SumPlane<uint16_t> plane;
    uint16_t* const from = plane.At(0, 0)->TileAt(0, 0);
    uint16_t* const to = plane.At(1, 0)->TileAt(0, 0);
    const auto meet = [&](auto move) {
      from[2] = 65000;
      from[3 * FreeBlock::kStride + 1] = 300;
      to[2] = to[2 * FreeBlock::kStride] = 600;
      to[3 * FreeBlock::kStride + 1] = to[FreeBlock::kStride + 3] = 200;
      move(from, RowGroups::kWholeTile, to);
      EXPECT_EQ(from[2], 0);
    };
    meet(kernel.free.move_apron);
    EXPECT_EQ(to[2], 65535);
    EXPECT_EQ(to[3 * FreeBlock::kStride + 1], 500);
    meet(kernel.free.move_transposed);
    EXPECT_EQ(to[2 * FreeBlock::kStride], 65535);
    EXPECT_EQ(to[FreeBlock::kStride + 3], 500);
  }
}

}  // namespace splinemap::scan_scratch_test
