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

TEST(MapMatchTest, HitsAreLookedUpAtTheirNearestControlPoint) {
  TileTreeEditor tiles;
  Tile& tile = tiles.Edit({0, 0}, 1);
  tile.control_points[IndexInTile(10, 4)] = -3 * kUnitsPerLogOdds;
  tile.control_points[IndexInTile(11, 4)] = 2 * kUnitsPerLogOdds;
  const TileTree tree = tiles.Freeze();
  const HitsInMap hits = FindHits(
      ScanWithHitsAt({{1.0, 0.4}, {1.04, 0.36}, {1.1, 0.4}, {-3, 1}, {1.2, 0.4}}), tree, 0.1);
  EXPECT_EQ(hits.looked_up, 5);
  EXPECT_EQ(hits.in_free, 2);
}

TEST(MapMatchTest, BeamsWithoutHitAreNotLookedUp) {
  TileTreeEditor tiles;
  tiles.Edit({0, 0}, 1).control_points[IndexInTile(10, 0)] = -3 * kUnitsPerLogOdds;
  PlacedScan scan = ScanWithHitsAt({{1.0, 0}});
  scan.beams[0].hit = false;
  EXPECT_EQ(FindHits(scan, tiles.Freeze(), 0.1).looked_up, 0);
}

}  // namespace splinemap::map_match_test
