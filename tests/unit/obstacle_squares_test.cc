#include "lib/distance/obstacle_squares.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <map>
#include <memory>
#include <random>
#include <set>

#include "tests/support/map_writer.h"

namespace splinemap::obstacle_squares_test {

constexpr double kKnot_m = 0.05;  // as MapOptions has it

constexpr CellMask kAllCells = [] {
  CellMask cells;
  cells.fill(~uint32_t{0});
  return cells;
}();

// Tiles of which some are known in part: noise, holes, levels that are the same everywhere.
std::shared_ptr<const MapView> RandomMap(uint64_t seed) {
  std::mt19937_64 random(seed);
  std::uniform_int_distribution<int> noise(-700, 400);
  MapWriter map(MapOptions{});
  Layer& layer = map.AddLayer({"robot", 1}, {1, 1});
  layer.BeginCommit();
  for (int j = -20; j <= 20; ++j) {
    for (int i = -20; i <= 20; ++i) {
      if (random() % 8 == 0) continue;
      const int value = i < -8 ? 600 : i > 8 ? -600 : noise(random);
      layer.EditTile(TileOf(i, j)).control_points[IndexInTile(i, j)] =
          static_cast<ControlPoint>(value == 0 ? 1 : value);
    }
  }
  return map.View();
}

// And those beside.
template <typename Visitor>
void ForEachTile(const TileTree& tiles, Visitor visit) {
  std::set<TileKey> keys;
  tiles.ForEach([&](TileKey key, const TileTree::Entry&) {
    ForEachAround(key, [&](TileKey around) { keys.insert(around); });
  });
  for (const TileKey key : keys) visit(key);
}

TEST(ObstacleSquaresTest, HaveWhatIsOccupiedOrUnknownAndNothingElse) {
  int num_set = 0;
  int num_clear = 0;
  for (uint64_t seed = 0; seed < 2; ++seed) {
    const auto map = RandomMap(seed);
    for (const UnknownPolicy unknown : {UnknownPolicy::kFree, UnknownPolicy::kBlocked}) {
      for (const double threshold : {0.0, -1.0, 0.7}) {
        ForEachTile(map->tiles, [&](TileKey key) {
          ObstacleSquares squares;
          ObstacleRasterizer(threshold * kUnitsPerLogOdds, unknown)
              .Update({map->tiles, key}, kAllCells, squares);
          for (int y = 0; y < ObstacleSquares::kSide; y += 9) {
            for (int x = 0; x < ObstacleSquares::kSide; x += 9) {
              // The square, at steps of 1/32 knot interval; unknown is all of it or nothing.
              double most = -1e9;
              bool is_unknown = false;
              for (int k = 0; k < 8 * 8; ++k) {
                const Eigen::Vector2d inner(0.5 + k % 8, 0.5 + k / 8);
                const Eigen::Vector2d at_m =
                    kKnot_m * (Tile::kSide * Eigen::Vector2d(key.tx, key.ty) +
                               (Eigen::Vector2d(x, y) + inner / 8) / ObstacleSquares::kPerKnot);
                const SurfaceSample sample = map->Evaluate(at_m.x(), at_m.y());
                is_unknown = is_unknown || !sample.known;
                if (sample.known) most = std::max(most, sample.log_odds);
              }
              const bool is_set = squares.IsSet(x, y);
              (is_set ? num_set : num_clear) += 1;
              if (is_unknown) {
                ASSERT_EQ(is_set, unknown == UnknownPolicy::kBlocked);
              } else if (is_set) {
                ASSERT_GT(most, threshold - 0.1) << x << " " << y;
              } else {
                ASSERT_LT(most, threshold) << x << " " << y;
              }
            }
          }
        });
      }
    }
  }
  EXPECT_GT(num_set, 1000);
  EXPECT_GT(num_clear, 1000);
}

TEST(ObstacleSquaresTest, OnlyTheCellsThatAreToldChange) {
  const auto map = RandomMap(1);
  const ObstacleRasterizer finder(0, UnknownPolicy::kFree);
  ObstacleSquares anew;
  finder.Update({map->tiles, {0, 0}}, kAllCells, anew);
  CellMask cells{};
  cells[3] = 0x30;
  for (const ObstacleSquares& before : {ObstacleSquares(), ObstacleSquares::All()}) {
    ObstacleSquares squares = before;
    finder.Update({map->tiles, {0, 0}}, cells, squares);
    for (int y = 0; y < ObstacleSquares::kSide; ++y) {
      for (int x = 0; x < ObstacleSquares::kSide; ++x) {
        const bool is_told = y / 4 == 3 && (x / 4 == 4 || x / 4 == 5);
        const ObstacleSquares& expected = is_told ? anew : before;
        ASSERT_EQ(squares.IsSet(x, y), expected.IsSet(x, y)) << x << " " << y;
      }
    }
  }
}

TEST(ObstacleSquaresTest, CellsChangeWhereOneOfTheirControlPointsDoes) {
  std::mt19937_64 random(1);
  std::uniform_int_distribution<int> knot(-36, 68);
  MapWriter map(MapOptions{});
  Layer& layer = map.AddLayer({"robot", 1}, {1, 1});
  for (int commit = 0; commit < 200; ++commit) {
    const auto before = map.View();
    layer.BeginCommit();
    const int i = knot(random);
    const int j = knot(random);
    ControlPoint& control_point = layer.EditTile(TileOf(i, j)).control_points[IndexInTile(i, j)];
    control_point = static_cast<ControlPoint>(control_point + 1);
    const auto after = map.View();
    std::map<TileKey, CellMask> changed;
    const CellMask cells = ChangedCells({0, 0}, [&](TileKey key) -> const CellMask& {
      const auto was = FindTile(before->tiles, key);
      const auto is = FindTile(after->tiles, key);
      const Tile untouched;
      return changed[key] =
                 ChangedPoints(was == nullptr ? untouched : *was, is == nullptr ? untouched : *is);
    });
    for (int y = 0; y < Tile::kSide; ++y) {
      for (int x = 0; x < Tile::kSide; ++x) {
        const bool is_near = i >= x - 1 && i <= x + 2 && j >= y - 1 && j <= y + 2;
        ASSERT_EQ((cells[y] >> x & 1) != 0, is_near) << i << " " << j << " " << x << " " << y;
      }
    }
  }
}

// A hill whose top is between the corners of a square is not missed.
TEST(ObstacleSquaresTest, PeaksWithinASquareAreFound) {
  MapWriter map(MapOptions{});
  Layer& layer = map.AddLayer({"robot", 1}, {1, 1});
  layer.BeginCommit();
  const auto put = [&](int i, int j, int value) {
    layer.EditTile(TileOf(i, j)).control_points[IndexInTile(i, j)] =
        static_cast<ControlPoint>(value);
  };
  for (int j = 4; j < 20; ++j) {
    for (int i = 4; i < 20; ++i) put(i, j, -256);
  }
  put(10, 10, 2000);
  put(11, 10, 700);
  const auto view = map.View();
  double most = -1e9;
  Eigen::Vector2d top_m;
  for (int k = 0; k < 400 * 400; ++k) {
    const Eigen::Vector2d at_m =
        kKnot_m * (Eigen::Vector2d(9, 9) + Eigen::Vector2d(k % 400, k / 400) / 100);
    const double log_odds = view->Evaluate(at_m.x(), at_m.y()).log_odds;
    if (log_odds > most) top_m = at_m;
    most = std::max(most, log_odds);
  }
  const double threshold = (most - 1e-5) * kUnitsPerLogOdds;
  ObstacleSquares squares;
  ObstacleRasterizer(threshold, UnknownPolicy::kFree)
      .Update({view->tiles, {0, 0}}, kAllCells, squares);
  const auto x = static_cast<int>(top_m.x() / kKnot_m * ObstacleSquares::kPerKnot);
  const auto y = static_cast<int>(top_m.y() / kKnot_m * ObstacleSquares::kPerKnot);
  EXPECT_TRUE(squares.IsSet(x, y));
}

}  // namespace splinemap::obstacle_squares_test
