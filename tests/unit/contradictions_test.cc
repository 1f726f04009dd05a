#include "lib/map/contradictions.h"

#include <gtest/gtest.h>

#include <thread>
#include <vector>

#include "lib/map/summed_layers.h"
#include "services/splinemapd/contradiction_watch.h"
#include "services/splinemapd/newest_map.h"
#include "tests/support/map_writer.h"
#include "tests/support/placement.h"

namespace splinemap::contradictions_test {

constexpr int kSide = 128;
const LayerId kOne{"one", 1};
const LayerId kTwo{"two", 2};

// A square of free space, its first knot at the origin, with a wall one knot thick where j is
// `wall_j`; without one for -1.
void MapRoom(Layer& layer, int wall_j, int side = kSide) {
  layer.BeginCommit();
  for (int j = 0; j < side; ++j) {
    for (int i = 0; i < side; ++i) {
      const int log_odds = j == wall_j ? 5 : -5;
      layer.EditTile(TileOf(i, j)).control_points[IndexInTile(i, j)] =
          static_cast<ControlPoint>(log_odds * kUnitsPerLogOdds);
    }
  }
}

// Of the first of two layers, whose walls are at these j.
Contradiction Compare(int wall_j, int other_wall_j, const LayerSettings& settings = {}) {
  MapWriter map(MapOptions{});
  MapRoom(map.AddLayer(kOne, {1, 1}), wall_j);
  MapRoom(map.AddLayer(kTwo, {1, 2}), other_wall_j);
  SettingsTable table;
  table.Merge(kOne, settings);
  map.SetSettings(table);
  return ContradictionsOf(map.Layers(), *map.View())[kOne];
}

TEST(ContradictionsTest, WallsInTheFreeSpaceOfOthersAreContradicted) {
  const Contradiction contradiction = Compare(50, 60);
  EXPECT_EQ(contradiction.compared, kSide);
  // At the border of the other layer its neighbours are not known.
  EXPECT_EQ(contradiction.contradicted, kSide - 4);
  EXPECT_TRUE(contradiction.IsTooMuch());
  EXPECT_EQ(ObstaclesText(contradiction), "97 % of 128 obstacles");
}

TEST(ContradictionsTest, WallsOfTwoKnotsBesideAreTheSameWall) {
  for (const int other : {48, 49, 50, 51, 52}) {
    const Contradiction contradiction = Compare(50, other);
    EXPECT_EQ(contradiction.compared, kSide);
    EXPECT_EQ(contradiction.contradicted, 0);
  }
}

TEST(ContradictionsTest, LayersAreComparedWhereSettingsPutThem) {
  const LayerSettings moved{.placement = ShiftBy(0, 10), .counter = 1};
  EXPECT_EQ(Compare(50, 60, moved).contradicted, 0);
  EXPECT_GT(Compare(50, 50, moved).contradicted, 100);
  // A wall that is turned has a part in the free space of the others.
  const LayerSettings turned{.placement = PlacedAt(0, 0, 20), .counter = 1};
  EXPECT_GT(Compare(50, 50, turned).contradicted, 50);
  const LayerSettings muted{.muted = true, .placement = {}, .counter = 1};
  EXPECT_EQ(Compare(50, 60, muted).compared, 0);
}

TEST(ContradictionsTest, WhatOthersDoNotKnowIsNotCompared) {
  MapWriter map(MapOptions{});
  MapRoom(map.AddLayer(kOne, {1, 1}), 50);
  const auto compare = [&] { return ContradictionsOf(map.Layers(), *map.View())[kOne]; };
  EXPECT_EQ(compare().compared, 0);
  MapRoom(map.AddLayer(kTwo, {1, 2}), -1, 60);
  EXPECT_EQ(compare().compared, 60);
  EXPECT_FALSE(compare().share());  // too little
  EXPECT_FALSE(compare().IsTooMuch());
}

TEST(ContradictionsTest, OfSeveralLayersTheOneInAnotherFrameStandsOut) {
  MapWriter map(MapOptions{});
  MapRoom(map.AddLayer(kOne, {1, 1}), 50);
  MapRoom(map.AddLayer(kTwo, {1, 2}), 50);
  MapRoom(map.AddLayer({"three", 3}, {1, 3}), 50);
  const LayerId moved{"moved", 4};
  MapRoom(map.AddLayer(moved, {1, 4}), 70);
  const auto contradictions = ContradictionsOf(map.Layers(), *map.View());
  EXPECT_TRUE(contradictions.at(moved).IsTooMuch());
  EXPECT_FALSE(contradictions.at(kOne).IsTooMuch());
}

TEST(ContradictionWatchTest, ComparesWhatChangedAfterAWhile) {
  MapWriter map(MapOptions{});
  Layer& one = map.AddLayer(kOne, {1, 1});
  Layer& two = map.AddLayer(kTwo, {1, 2});
  MapRoom(one, 50);
  MapRoom(two, 60);
  NewestMap newest(map.options(), one.Snapshot());
  newest.SetFollowed({two.Snapshot()}, {});
  ContradictionWatch early(Clock::now());
  EXPECT_FALSE(early.Check(newest));
  ContradictionWatch watch(Clock::now() - std::chrono::hours(1));
  ASSERT_TRUE(watch.Check(newest));
  EXPECT_TRUE(watch.contradictions().at(kOne).IsTooMuch());
  EXPECT_TRUE(watch.contradictions().at(kTwo).IsTooMuch());
  EXPECT_FALSE(watch.Check(newest));
  // Settings count at once, tiles after a while.
  MapRoom(two, 61);
  newest.SetFollowed({two.Snapshot()}, {});
  EXPECT_FALSE(watch.Check(newest));
  SettingsTable settings;
  settings.Merge(kTwo, {.placement = ShiftBy(0, -11), .counter = 1});
  newest.SetFollowed({two.Snapshot()}, settings);
  bool is_checked = false;
  for (int k = 0; k < 1000 && !is_checked; ++k) {
    is_checked = watch.Check(newest);
    if (!is_checked) std::this_thread::sleep_for(std::chrono::milliseconds(10));
  }
  ASSERT_TRUE(is_checked);
  EXPECT_FALSE(watch.contradictions().at(kTwo).IsTooMuch());
}

}  // namespace splinemap::contradictions_test
