#include "lib/map/summed_layers.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <map>
#include <memory>
#include <random>
#include <vector>

#include "lib/map/map_changes.h"
#include "lib/map/placed_tile.h"
#include "splinemap/layer_set.h"
#include "splinemap/map_view.h"
#include "tests/support/placement.h"
#include "tests/support/random_map.h"

namespace splinemap::summed_layers_test {

constexpr ControlLimits kLimits{-2560, 2560};

using Points = std::map<std::pair<int32_t, int32_t>, ControlPoint>;

Points PointsOf(const TileTree& tree) {
  Points points;
  tree.ForEach([&](TileKey key, const TileTree::Entry& entry) {
    const auto tile = entry.tile->Get();
    for (int k = 0; k < Tile::kSize; ++k) {
      const ControlPoint c = tile->control_points[k];
      if (c != 0) points[{32 * key.tx + (k & 31), 32 * key.ty + (k >> 5)}] = c;
    }
  });
  return points;
}

// The definition, control point by control point.
Points SimplySummed(const LayerSet& set) {
  std::map<std::pair<int32_t, int32_t>, int32_t> sums;
  std::map<std::pair<int32_t, int32_t>, int32_t> low_weight_sums;
  for (const LayerSnapshot& layer : set.layers) {
    const LayerSettings& setting = set.settings.Of(layer.id);
    if (setting.muted) continue;
    auto& summed = setting.low_weight ? low_weight_sums : sums;
    const KnotPlacement placement(setting.placement, set.options.knot_interval_m);
    for (const auto& [at, c] : PointsOf(Placed(layer.tiles, placement))) summed[at] += c;
  }
  for (const auto& [at, sum] : low_weight_sums) sums[at] += ClampTouched(sum, {-2048, 2048});
  Points points;
  for (const auto& [at, sum] : sums) points[at] = ClampTouched(sum, kLimits);
  return points;
}

// Random commits of robots that come and go, begin anew, are muted and placed.
class SummedLayersTest : public testing::Test {
 protected:
  using Random = std::mt19937_64;

  void Step(Random& random) {
    const auto robot = static_cast<uint64_t>(random() % 5);
    const LayerId id{"robot", robot};
    switch (random() % 10) {
      case 0:
        layers_.erase(robot);
        break;
      case 1:
        layers_[robot] = std::make_unique<Layer>(id, SessionId{++sessions_, robot});
        break;
      case 2:
      case 3: {
        LayerSettings setting = settings_.Next(id, random());
        if (random() % 3 == 0) {
          (random() % 3 == 0 ? setting.muted : setting.low_weight) ^= true;
        } else {
          setting.placement = ShiftBy(int32_t(random() % 200) - 100, 32.0 * int32_t(random() % 3));
          if (random() % 2 == 0) setting.placement.yaw = static_cast<int32_t>(random());
        }
        if (random() % 5 == 0) setting.placement = {};
        EXPECT_TRUE(settings_.Merge(id, setting));
        break;
      }
      default:
        std::unique_ptr<Layer>& layer = layers_[robot];
        if (!layer) layer = std::make_unique<Layer>(id, SessionId{++sessions_, robot});
        layer->BeginCommit();
        for (int n = 0; n < 3; ++n)
          layer->EditTile(RandomKey(random, 1)) = RandomTile(random, kLimits);
    }
  }
  LayerSet Layers() {
    LayerSet set{.options = {.limits = kLimits}, .settings = settings_};
    for (auto& [robot, layer] : layers_) set.layers.push_back(layer->Snapshot());
    return set;
  }

  std::map<uint64_t, std::unique_ptr<Layer>> layers_;
  SettingsTable settings_;
  uint64_t sessions_ = 0;
};

TEST_F(SummedLayersTest, IsTheSumOfWhatIsThereWhateverHappenedBefore) {
  Random random(1);
  SummedLayers sum;
  SummedLayers backwards;
  std::shared_ptr<const MapView> shown = std::make_shared<MapView>();
  int changes = 0;
  int placed_anew = 0;  // while other layers were there
  for (int step = 0; step < 150; ++step) {
    const SettingsTable before_step = settings_;
    Step(random);
    LayerSet set = Layers();
    for (const LayerSnapshot& layer : set.layers) {
      const bool is_placed_anew =
          settings_.Of(layer.id).placement != before_step.Of(layer.id).placement;
      placed_anew += is_placed_anew && !settings_.Of(layer.id).muted && layer.tiles.size() > 0 &&
                     set.layers.size() > 2;
    }
    const auto view = sum.Update(set);
    const Points expected = SimplySummed(set);
    ASSERT_EQ(PointsOf(view->tiles), expected) << "step " << step;
    ASSERT_EQ(PointsOf(ViewOf(set)->tiles), expected) << "step " << step;
    std::reverse(set.layers.begin(), set.layers.end());
    ASSERT_EQ(PointsOf(backwards.Update(set)->tiles), expected);
    // Nothing changes beside what is said to have changed.
    const TileBox changed = ChangedTiles(*shown, *view);
    const Points before = PointsOf(shown->tiles);
    for (const auto& [a, b] : {std::pair(&before, &expected), std::pair(&expected, &before)}) {
      for (const auto& [at, c] : *a) {
        const auto other = b->find(at);
        if (other != b->end() && other->second == c) continue;
        ASSERT_TRUE(changed.Contains(TileOf(at.first, at.second)));
        ++changes;
      }
    }
    shown = view;
  }
  EXPECT_GT(changes, 10'000);
  EXPECT_GT(placed_anew, 5);
}

TEST_F(SummedLayersTest, ReadersThatGotTilesInAnotherOrderHaveTheSameBytes) {
  Random random(9);
  std::vector<LayerId> ids;
  for (uint64_t n = 0; n < 3; ++n) {
    ids.push_back({"robot", n});
    LayerSettings setting = settings_.Next(ids.back(), 1);
    setting.placement = PlacedAt(0.1 + static_cast<double>(n), -0.7, 25 + 40.0 * int(n));
    setting.low_weight = n == 2;
    EXPECT_TRUE(settings_.Merge(ids.back(), setting));
  }
  struct Update {
    LayerId id;
    TileKey key;
    std::shared_ptr<const StoredTile> tile;
    uint64_t revision;
  };
  std::vector<Update> updates;
  for (uint64_t n = 1; n <= 60; ++n) {
    updates.push_back({ids[random() % 3], RandomKey(random, 2),
                       std::make_shared<const StoredTile>(RandomTile(random, kLimits)), n});
  }
  Points first;
  for (int reader = 0; reader < 5; ++reader) {
    SummedLayers sum;
    std::map<LayerId, Layer> layers;
    for (const LayerId& id : ids) layers.emplace(id, Layer(id, {1, 1}));
    std::shared_ptr<const MapView> view;
    for (size_t n = 0; n < updates.size(); ++n) {
      const Update& update = updates[n];
      layers.at(update.id).RestoreTile(update.key, update.tile, update.revision);
      if (random() % 4 != 0 && n + 1 < updates.size()) continue;
      LayerSet set{.options = {.limits = kLimits}, .settings = settings_};
      for (auto& [id, layer] : layers) set.layers.push_back(layer.Snapshot());
      view = sum.Update(set);
    }
    if (reader == 0) first = PointsOf(view->tiles);
    ASSERT_EQ(PointsOf(view->tiles), first);
    std::shuffle(updates.begin(), updates.end(), random);
  }
  EXPECT_GT(first.size(), 10'000u);
}

TEST_F(SummedLayersTest, APlacementThatIsTakenBackLeavesNothingBehind) {
  Random random(10);
  Layer layer(LayerId{"robot", 1}, SessionId{1, 1});
  layer.BeginCommit();
  for (int n = 0; n < 9; ++n) layer.EditTile(RandomKey(random, 2)) = RandomTile(random, kLimits);
  LayerSet set{.options = {.limits = kLimits}, .layers = {layer.Snapshot()}};
  SummedLayers sum;
  const Points before = PointsOf(sum.Update(set)->tiles);
  LayerSettings setting = set.settings.Next(layer.id(), 1);
  setting.placement = PlacedAt(0.3, 0.4, 50);
  set.settings.Merge(layer.id(), setting);
  EXPECT_NE(PointsOf(sum.Update(set)->tiles), before);
  setting = set.settings.Next(layer.id(), 1);
  setting.placement = PlacedAt(0, 0, 0);
  set.settings.Merge(layer.id(), setting);
  EXPECT_EQ(PointsOf(sum.Update(set)->tiles), before);
}

TEST_F(SummedLayersTest, APlacementBeyondEveryMapLeavesOutWhatCannotBe) {
  constexpr int32_t kLast = (kMaxKnotIndex >> 5);
  Layer layer(LayerId{"robot", 1}, SessionId{1, 1});
  layer.BeginCommit();
  layer.EditTile({kLast, 0}).control_points.fill(9);
  layer.EditTile({0, 0}).control_points.fill(7);
  LayerSettings setting = settings_.Next(layer.id(), 1);
  constexpr int32_t kKnots = 1 << 26;
  setting.placement = ShiftBy(kKnots, -kKnots);
  settings_.Merge(layer.id(), setting);
  const auto view =
      ViewOf({.options = {.limits = kLimits}, .layers = {layer.Snapshot()}, .settings = settings_});
  ASSERT_EQ(view->tiles.size(), 1u);
  EXPECT_EQ(FindTile(view->tiles, {kKnots / 32, -kKnots / 32})->control_points[5], 7);
}

TEST(SettingsTableTest, AnyOrderGroupingAndRepetitionGivesTheSameRecords) {
  std::mt19937_64 random(8);
  for (int round = 0; round < 200; ++round) {
    // Several writers, who do not know of each other, so that counters repeat.
    std::vector<std::pair<LayerId, LayerSettings>> records;
    for (int n = 0; n < 30; ++n) {
      LayerSettings setting;
      setting.muted = random() % 2 == 0;
      setting.placement = {int64_t(random() % 3), int64_t(random() % 3), int32_t(random() % 2)};
      setting.counter = random() % 4;
      setting.writer = random() % 3;
      setting.removed_up_to = random() % 3 == 0 ? random() % 100 : 0;
      records.push_back({{"robot", random() % 4}, setting});
    }
    SettingsTable all;
    for (const auto& [id, setting] : records) all.Merge(id, setting);
    std::vector<SettingsTable> groups(3);
    for (int n = 0; n < 60; ++n) {
      std::shuffle(records.begin(), records.end(), random);
      for (size_t k = 0; k < records.size(); ++k) {
        groups[k % 3].Merge(records[k].first, records[k].second);
      }
    }
    SettingsTable together = groups[2];
    together.Merge(groups[0]);
    together.Merge(groups[1]);
    ASSERT_EQ(together, all);
    ASSERT_EQ(together.hash(), all.hash());
    EXPECT_FALSE(together.Merge(all));
  }
}

TEST(SettingsTableTest, ARemovalCannotBeUndoneAndTakesTheWholeGeneration) {
  const LayerId id{"robot", 1};
  SettingsTable settings;
  const LayerSettings removal = settings.Removal(id, {5, 1}, 10);
  LayerSettings mute = settings.Next(id, 20);  // by somebody who has not heard of it
  mute.muted = true;
  settings.Merge(id, removal);
  settings.Merge(id, mute);
  EXPECT_TRUE(settings.Of(id).muted);
  EXPECT_TRUE(settings.Of(id).IsRemoved({6, 1})) << "a start with what was removed";
  EXPECT_FALSE(settings.Of(id).IsRemoved({LayerSettings::kSessionsPerGeneration, 1}));
  EXPECT_TRUE(settings.Of(id).IsValid());
}

TEST(SettingsTableTest, RecordsAreBounded) {
  SettingsTable settings;
  for (uint64_t n = 0; n < SettingsTable::kMax; ++n) {
    EXPECT_TRUE(settings.Merge({"robot", n}, settings.Next({"robot", n}, 1)));
  }
  EXPECT_FALSE(settings.Merge({"robot", 5000}, settings.Next({"robot", 5000}, 1)));
  EXPECT_EQ(settings.records().size(), SettingsTable::kMax);
  LayerSettings bad;
  bad.placement.x = FixedPose2::kMaxUnits + 1;
  EXPECT_FALSE(bad.IsValid());
}

}  // namespace splinemap::summed_layers_test
