#include "lib/mapping/scan_scratch.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstddef>
#include <numbers>
#include <random>
#include <vector>

#include "lib/mapping/beam_model.h"
#include "lib/tiles/tile_memory.h"
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

// Cells by the definition: control points that no beam that passes changes.
TileCells PlainSettledCells(const Tile& tile) {
  TileCells cells = ~TileCells{0};
  for (int k = 0; k < Tile::kSize; ++k) {
    const int from_free = tile.control_points[k] - kFreeControlPoint;
    const bool is_settled = from_free >= -1 && from_free <= 2;
    if (!is_settled) cells &= ~(TileCells{1} << (k / Tile::kSide / 4 * 8 + k % Tile::kSide / 4));
  }
  return cells;
}

TEST(SettledCellsTest, AreThoseOfWhichEachControlPointIsAsFreeAsItGets) {
  std::mt19937_64 random(1);
  for (int n = 0; n < 200; ++n) {
    Tile tile;
    for (ControlPoint& c : tile.control_points) {
      c = static_cast<ControlPoint>(kFreeControlPoint - 1 + static_cast<int>(random() % 4));
    }
    for (int k = 0; k < n; ++k) {
      const int from_free = k % 2 == 0 ? -2 : 3;
      tile.control_points[random() % Tile::kSize] =
          static_cast<ControlPoint>(kFreeControlPoint + from_free);
    }
    EXPECT_EQ(SettledCellsOf(tile), PlainSettledCells(tile));
  }
  EXPECT_EQ(SettledCellsOf(Tile()), 0u);
}

// Beams in all directions whose ranges change from scan to scan, so that what was free is not
// always.
std::vector<PlacedBeam> DisagreeingScan(std::mt19937_64& random) {
  constexpr double kKnot_m = 0.05;
  const auto uniform = [&](double from, double to) {
    return std::uniform_real_distribution<double>(from, to)(random);
  };
  const double wall_m = uniform(1, 9);
  const Eigen::Vector2d origin_m(uniform(-1, 1), uniform(-1, 1));
  std::vector<PlacedBeam> beams;
  for (int k = 0; k < 360; ++k) {
    const double bearing_rad = (k + uniform(0, 1)) * std::numbers::pi / 180;
    const Eigen::Vector2d direction(std::cos(bearing_rad), std::sin(bearing_rad));
    const double range_m = k % 40 == 0 ? uniform(kKnot_m, 9) : wall_m + uniform(0, 0.03);
    beams.push_back({origin_m, direction, range_m, k % 7 != 0});
  }
  return beams;
}

TEST(SettledCellsTest, WhatIsLeftOutChangesNothingInEveryKernel) {
  // With these no cell is taken for settled, and no control point is moved by them.
  constexpr ControlLimits kLeaveNothingOut{.min = kFreeControlPoint};
  for (const ScanKernel& kernel : ScanKernels()) {
    SCOPED_TRACE(kernel.name);
    std::mt19937_64 random(1);
    Layer layer{LayerId{"robot", 1}, SessionId{1, 1}};
    Layer whole{LayerId{"robot", 1}, SessionId{1, 1}};
    ScanScratch scratch(kernel);
    BeamModel model({}, 0.05, kernel);
    std::vector<LayerSnapshot> held;  // so that tiles are not always written in place
    for (int n = 0; n < 40; ++n) {
      const std::vector<PlacedBeam> beams = DisagreeingScan(random);
      model.Accumulate(beams, scratch);
      scratch.CommitTo(layer, kLimits);
      model.Accumulate(beams, scratch);
      scratch.CommitTo(whole, kLeaveNothingOut);
      if (n % 3 == 0) held.push_back(layer.Snapshot());
      int settled = 0;
      layer.tiles().ForEach([&](TileKey key, const TileTree::Entry& entry) {
        const auto expected = FindTile(whole.tiles(), key);
        ASSERT_NE(expected, nullptr);
        ASSERT_EQ(*entry.tile->Get(), *expected) << n << " " << key.tx << " " << key.ty;
        EXPECT_EQ(entry.revision, whole.tiles().RevisionOf(key));
        EXPECT_EQ(entry.tile->SettledCells(), SettledCellsOf(*expected));
        settled += std::popcount(SettledCellsOf(*expected));
      });
      EXPECT_EQ(layer.tiles().size(), whole.tiles().size());
      EXPECT_GT(settled, 100);
    }
  }
}

// One tile, kept elsewhere, which is read while nothing is broken.
class OneTile : public TileSource {
 public:
  explicit OneTile(const Tile& tile) : TileSource(std::make_shared<TileMemory>(1)), tile_(tile) {}
  std::shared_ptr<const Tile> Load(int64_t /*number*/, uint64_t /*checksum*/) override {
    return is_broken ? nullptr : std::make_shared<const Tile>(tile_);
  }
  bool is_broken = false;

 private:
  const Tile tile_;
};

TEST(TilesElsewhereTest, ATileThatLeavesMemoryBeforeItIsWrittenKeepsItsRows) {
  Tile before;
  for (int k = 0; k < Tile::kSize; ++k) {
    before.control_points[k] = static_cast<ControlPoint>(k % 200 - 900);
  }
  const auto source = std::make_shared<OneTile>(before);
  const auto other = std::make_shared<const StoredTile>(source, 2);
  TileTreeEditor tiles;
  tiles.Put({0, 0}, std::make_shared<const StoredTile>(source, 1), 1);
  ScanScratch scratch;
  BeamModel model({}, 0.05);
  // Along the column of control points 20, up to row 14.
  model.Accumulate(std::vector<PlacedBeam>{{{1.0, 0.2}, {0, 1}, 0.5, true}}, scratch);
  int asked = 0;
  scratch.CommitTo(tiles, 2, kLimits, {}, [&](TileKey key) {
    EXPECT_EQ(key, (TileKey{0, 0}));
    ++asked;
    for (int n = 0; n < 3; ++n) other->Get();  // takes its place
    source->is_broken = true;
    EXPECT_EQ(tiles.tree().Find(key)->TryGet(), nullptr) << "it did not leave";
    return true;
  });
  EXPECT_EQ(asked, 1);
  const auto after = FindTile(tiles.tree(), {0, 0});
  EXPECT_NE(after->control_points[IndexInTile(20, 10)], before.control_points[IndexInTile(20, 10)]);
  for (int k = IndexInTile(0, 20); k < Tile::kSize; ++k) {
    EXPECT_EQ(after->control_points[k], before.control_points[k]) << k;
  }
}

TEST(SettledCellsTest, PairsOfRowsAreLeftOutWhereAllOfTheirCellsAre) {
  const FreeLineTable<uint16_t> table(SignedDistance::kWeightPerKnot, Footprint::kBasis);
  std::vector<FreeLine> lines = FanOfLines();
  std::mt19937_64 random(1);
  for (FreeLine& line : lines) line.first_row += static_cast<int32_t>(random() % 60);
  uint64_t cells[SettledCells::kRows];
  for (uint64_t& row : cells) row = random() | random() | random();
  const auto is_left_out = [&](int row, int64_t first_column, int64_t end_column) {
    for (int64_t k = first_column / 4; k <= (end_column - 1) / 4; ++k) {
      if ((cells[row / 4] >> k & 1) == 0) return false;
    }
    return true;
  };
  std::vector<FreeLine> pairs;
  for (const FreeLine& line : lines) {
    for (int n = 0; n < line.rows; n += 2) {
      FreeLine pair = line;
      pair.column += int64_t{line.columns_per_row} * n;
      pair.first_row += n;
      pair.rows = std::min(2, line.rows - n);
      const int64_t column = pair.column >> FreeLine::kFractionBits;
      // Kernels ask for three cells and two rows, also where a pair lies in fewer.
      const int64_t end_column = (column / 4 + 3) * 4;
      if (!is_left_out(pair.first_row, column, end_column) ||
          !is_left_out(pair.first_row + 1, column, end_column)) {
        pairs.push_back(pair);
      }
    }
  }
  EXPECT_GT(pairs.size(), lines.size());
  EXPECT_LT(pairs.size(), 8 * lines.size());
  const std::vector<uint16_t> expected = CappedSums(pairs, table.data());
  for (const ScanKernel& kernel : ScanKernels()) {
    SumPlane<uint16_t> plane;
    plane.OnAdd([&](FreeBlock& block) { block.marks.Set(cells); });
    kernel.add_free_lines(lines.data(), lines.size(), table.data(), plane);
    ASSERT_EQ(plane.size(), 1u) << kernel.name;
    EXPECT_TRUE(std::ranges::equal(expected, absl::MakeSpan(plane.block(0).sums, expected.size())))
        << kernel.name;
  }
}

TEST(SettledCellsTest, NoKernelTouchesWhatIsSettled) {
  const FreeLineTable<uint16_t> table(SignedDistance::kWeightPerKnot, Footprint::kBasis);
  const std::vector<FreeLine> lines = FanOfLines();
  uint64_t cells[SettledCells::kRows];
  for (const ScanKernel& kernel : ScanKernels()) {
    std::fill(std::begin(cells), std::end(cells), ~uint64_t{0});
    SumPlane<uint16_t> plane;
    plane.OnAdd([&](FreeBlock& block) { block.marks.Set(cells); });
    kernel.add_free_lines(lines.data(), lines.size(), table.data(), plane);
    ASSERT_EQ(plane.size(), 1u);
    EXPECT_EQ(std::ranges::count(plane.block(0).touched, 0u), 8) << kernel.name;
    plane.Clear();
    cells[4] = 0;  // rows 16 to 19
    kernel.add_free_lines(lines.data(), lines.size(), table.data(), plane);
    EXPECT_LT(std::ranges::count(plane.block(0).touched, 0u), 8) << kernel.name;
    // Pairs of rows that begin with row 15 or end with row 20 at most.
    for (const uint32_t groups : plane.block(0).touched) {
      EXPECT_EQ(groups & ~0b111000u, 0u) << kernel.name;
    }
  }
}

// Those of wide limits, where differences to the value of free space need more than 16 bits.
TEST(FreeWeightsTest, ControlPointsMoveAPartOfTheWayInEveryKernel) {
  constexpr ControlLimits kWide{-32767, 32767};
  for (const ScanKernel& kernel : ScanKernels()) {
    SCOPED_TRACE(kernel.name);
    SumPlane<uint16_t> plane;
    uint16_t* const free = plane.At(0, 0)->TileAt(0, 0);
    Tile before;
    Tile expected;
    Tile after;
    for (int k = 0; k < Tile::kSize; ++k) {
      const int old = 64 * k - 32767;
      const int weight = k * 7 % 3000;
      const int difference = std::max(SignedDistance::kFree - old, -32768);
      const int share = difference * std::min(weight, SignedDistance::kMostWeight);
      const int moved =
          old + ((share + (1 << (SignedDistance::kForgetBits - 1))) >> SignedDistance::kForgetBits);
      free[k / Tile::kSide * FreeBlock::kStride + k % Tile::kSide] = static_cast<uint16_t>(weight);
      before.control_points[k] = static_cast<ControlPoint>(old);
      expected.control_points[k] = static_cast<ControlPoint>(weight == 0 || moved != 0 ? moved : 1);
    }
    TileCells settled = 0;
    EXPECT_TRUE(kernel.commit_distances(free, RowGroups::kWholeTile, nullptr, 0, kWide,
                                        before.control_points.data(), after.control_points.data(),
                                        settled));
    EXPECT_EQ(after, expected);
    EXPECT_EQ(settled, SettledCellsOf(after));
  }
}

}  // namespace splinemap::scan_scratch_test
