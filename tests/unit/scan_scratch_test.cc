#include "lib/mapping/scan_scratch.h"

#include <gtest/gtest.h>

#include "splinemap/map_view.h"

namespace splinemap::scan_scratch_test {

constexpr int kUnit = 1 << ScanScratch::kFractionBits;  // one unit of a control point
constexpr ControlLimits kLimits;

class ScanScratchTest : public testing::Test {
 protected:
  ControlPoint At(int i, int j) const {
    const Tile* tile = layer_.tiles().Find(TileOf(i, j));
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

}  // namespace splinemap::scan_scratch_test
