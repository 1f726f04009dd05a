#include "lib/diagnosis/map_match.h"

#include <gtest/gtest.h>

namespace splinemap::map_match_test {

PlacedScan ScanWithHitsAt(const std::vector<Eigen::Vector2d>& points) {
  PlacedScan scan;
  for (const Eigen::Vector2d& point : points) {
    scan.beams.push_back({{0, 0}, point.normalized(), point.norm(), true});
  }
  return scan;
}

TEST(MapMatchTest, HitsAreInFreeSpaceWhereAllIsFreeAroundThem) {
  TileTreeEditor tiles;
  Tile& tile = tiles.Edit({0, 0}, 1).Edit();
  for (int k = 0; k < 20 * 20; ++k) {
    tile.control_points[IndexInTile(k % 20, k / 20)] = -3 * kUnitsPerLogOdds;
  }
  tile.control_points[IndexInTile(11, 4)] = 2 * kUnitsPerLogOdds;
  const TileTree tree = tiles.Freeze();
  // In free space; beside the obstacle, a little further, at it; in the unknown, and at its edge.
  const HitsInMap hits = FindHits(
      ScanWithHitsAt({{0.5, 0.4}, {1.04, 0.36}, {0.94, 0.4}, {1.1, 0.4}, {-3, 1}, {1.96, 0.4}}),
      tree, 0.1);
  EXPECT_EQ(hits.looked_up, 6);
  EXPECT_EQ(hits.in_free, 2);
}

TEST(MapMatchTest, BeamsWithoutHitAreNotLookedUp) {
  TileTreeEditor tiles;
  tiles.Edit({0, 0}, 1).Edit().control_points[IndexInTile(10, 0)] = -3 * kUnitsPerLogOdds;
  PlacedScan scan = ScanWithHitsAt({{1.0, 0}});
  scan.beams[0].hit = false;
  EXPECT_EQ(FindHits(scan, tiles.Freeze(), 0.1).looked_up, 0);
}

}  // namespace splinemap::map_match_test
