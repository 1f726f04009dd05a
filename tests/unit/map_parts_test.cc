#include "lib/render/map_parts.h"

#include <gtest/gtest.h>

#include "tests/support/map_writer.h"

namespace splinemap::map_parts_test {

std::vector<MapPart> PartsOfTiles(const std::vector<TileKey>& keys) {
  MapWriter map({0.05, {}});
  Layer& layer = map.AddLayer({"robot", 1}, {1, 1});
  layer.BeginCommit();
  for (const TileKey key : keys) layer.EditTile(key).control_points[0] = 1;
  return PartsOf(*map.View());
}

TEST(MapPartsTest, TilesThatLieTogetherAreOnePart) {
  // A diagonal across the origin, with gaps of less than 8 tiles.
  const auto parts = PartsOfTiles({{-17, -15}, {-10, -8}, {-3, -1}, {4, 6}, {11, 13}});
  ASSERT_EQ(parts.size(), 1u);
  EXPECT_EQ(parts[0].tiles, 5u);
  EXPECT_EQ(parts[0].box, (TileBox{-17, -15, 12, 14}));
}

TEST(MapPartsTest, TheLargestPartComesFirst) {
  constexpr int32_t kFar = kMaxKnotIndex >> 5;
  const auto parts = PartsOfTiles({{kFar, -kFar}, {0, 0}, {1, 0}, {0, 100}, {1, 100}, {2, 100}});
  ASSERT_EQ(parts.size(), 3u);
  EXPECT_EQ(parts[0].box, (TileBox{0, 100, 3, 101}));
  EXPECT_EQ(parts[1].box, (TileBox{0, 0, 2, 1}));
  EXPECT_EQ(parts[2].box, (TileBox{kFar, -kFar, kFar + 1, -kFar + 1}));
  EXPECT_EQ(BoxOf(parts), (TileBox{0, -kFar, kFar + 1, 101}));
}

TEST(MapPartsTest, AnEmptyMapHasNone) {
  EXPECT_TRUE(PartsOfTiles({}).empty());
  EXPECT_TRUE(BoxOf({}).IsEmpty());
}

}  // namespace splinemap::map_parts_test
