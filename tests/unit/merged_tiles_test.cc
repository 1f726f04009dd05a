#include "lib/map/merged_tiles.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <map>
#include <memory>
#include <random>
#include <vector>

#include "lib/map/map.h"
#include "lib/map/map_changes.h"
#include "tests/support/random_map.h"

namespace splinemap::merged_tiles_test {

constexpr ControlLimits kLimits{-2560, 2560};

using Points = std::map<std::pair<int32_t, int32_t>, ControlPoint>;

Points PointsOf(const TileTree& tree) {
  Points points;
  tree.ForEach([&](TileKey key, const TileTree::Entry& entry) {
    for (int k = 0; k < Tile::kSize; ++k) {
      const ControlPoint c = entry.tile->control_points[k];
      if (c != 0) points[{32 * key.tx + (k & 31), 32 * key.ty + (k >> 5)}] = c;
    }
  });
  return points;
}

// The definition, control point by control point.
Points SimplyMerged(const std::vector<LayerSnapshot>& layers, const LayerControls& controls) {
  std::map<std::pair<int32_t, int32_t>, int32_t> sums;
  std::map<std::pair<int32_t, int32_t>, int32_t> yielding;
  for (const LayerSnapshot& layer : layers) {
    const LayerControl& control = controls.Of(layer.id);
    if (control.muted || control.alignment != std::array<double, 3>{}) continue;
    auto& summed = control.yields ? yielding : sums;
    for (const auto& [at, c] : PointsOf(layer.tiles)) {
      summed[{at.first + control.shift.i, at.second + control.shift.j}] += c;
    }
  }
  for (const auto& [at, sum] : yielding) sums[at] += ClampTouched(sum, {-2048, 2048});
  Points points;
  for (const auto& [at, sum] : sums) points[at] = ClampTouched(sum, kLimits);
  return points;
}

// Random commits of robots that come and go, begin anew, are muted and shifted.
class MergedTilesTest : public testing::Test {
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
        layers_[robot] = std::make_unique<Layer>(id, LayerEpoch{++lives_, robot});
        break;
      case 2:
      case 3: {
        LayerControl control = controls_.Next(id, random());
        if (random() % 2 == 0) {
          (random() % 2 == 0 ? control.muted : control.yields) ^= true;
        } else {
          control.shift = {int32_t(random() % 200) - 100, int32_t(random() % 3) * 32};
        }
        if (random() % 5 == 0) control.shift = {};
        if (random() % 8 == 0) control.alignment[2] = control.alignment[2] == 0 ? 0.1 : 0;
        EXPECT_TRUE(controls_.Take(id, control));
        break;
      }
      default:
        std::unique_ptr<Layer>& layer = layers_[robot];
        if (!layer) layer = std::make_unique<Layer>(id, LayerEpoch{++lives_, robot});
        layer->BeginCommit();
        for (int n = 0; n < 3; ++n)
          layer->EditTile(RandomKey(random, 1)) = RandomTile(random, kLimits);
    }
  }
  std::vector<LayerSnapshot> Layers() {
    std::vector<LayerSnapshot> layers;
    for (auto& [robot, layer] : layers_) layers.push_back(layer->Snapshot());
    return layers;
  }

  std::map<uint64_t, std::unique_ptr<Layer>> layers_;
  LayerControls controls_;
  uint64_t lives_ = 0;
};

TEST_F(MergedTilesTest, IsTheSumOfWhatIsThereWhateverHappenedBefore) {
  Random random(3);
  MergedTiles merged;
  MergedTiles backwards;
  std::shared_ptr<const MapSnapshot> shown = std::make_shared<MapSnapshot>();
  int changes = 0;
  for (int step = 0; step < 150; ++step) {
    Step(random);
    std::vector<LayerSnapshot> layers = Layers();
    auto snapshot = std::make_shared<MapSnapshot>();
    snapshot->layers = layers;
    snapshot->merged = merged.Update(layers, controls_, kLimits);
    const Points expected = SimplyMerged(layers, controls_);
    ASSERT_EQ(PointsOf(snapshot->merged), expected) << "step " << step;
    std::reverse(layers.begin(), layers.end());
    ASSERT_EQ(PointsOf(backwards.Update(layers, controls_, kLimits)), expected);
    // Nothing changes beside what is said to have changed.
    const TileBox changed = ChangedTiles(*shown, *snapshot);
    const Points before = PointsOf(shown->merged);
    for (const auto& [a, b] : {std::pair(&before, &expected), std::pair(&expected, &before)}) {
      for (const auto& [at, c] : *a) {
        const auto other = b->find(at);
        if (other != b->end() && other->second == c) continue;
        ASSERT_TRUE(changed.Contains(TileOf(at.first, at.second)));
        ++changes;
      }
    }
    shown = snapshot;
  }
  EXPECT_GT(changes, 10'000);
}

TEST_F(MergedTilesTest, AShiftBeyondEveryMapLeavesOutWhatCannotBe) {
  constexpr int32_t kLast = (kMaxKnotIndex >> 5);
  Layer layer(LayerId{"robot", 1}, LayerEpoch{1, 1});
  layer.BeginCommit();
  layer.EditTile({kLast, 0}).control_points.fill(9);
  layer.EditTile({0, 0}).control_points.fill(7);
  LayerControl control = controls_.Next(layer.id(), 1);
  control.shift = {KnotShift::kMax, -KnotShift::kMax};
  controls_.Take(layer.id(), control);
  const TileTree merged = MergedTiles().Update({layer.Snapshot()}, controls_, kLimits);
  ASSERT_EQ(merged.size(), 1u);
  EXPECT_EQ(merged.Find({KnotShift::kMax / 32, -KnotShift::kMax / 32})->control_points[5], 7);
}

TEST(LayerControlsTest, AnyOrderGroupingAndRepetitionGivesTheSameRecords) {
  std::mt19937_64 random(8);
  for (int round = 0; round < 200; ++round) {
    // Several writers, who do not know of each other, so that counters repeat.
    std::vector<std::pair<LayerId, LayerControl>> records;
    for (int n = 0; n < 30; ++n) {
      LayerControl control;
      control.muted = random() % 2 == 0;
      control.shift = {int32_t(random() % 3), int32_t(random() % 3)};
      control.counter = random() % 4;
      control.writer = random() % 3;
      control.removed_up_to = random() % 3 == 0 ? random() % 100 : 0;
      records.push_back({{"robot", random() % 4}, control});
    }
    LayerControls all;
    for (const auto& [id, control] : records) all.Take(id, control);
    std::vector<LayerControls> groups(3);
    for (int n = 0; n < 60; ++n) {
      std::shuffle(records.begin(), records.end(), random);
      for (size_t k = 0; k < records.size(); ++k) {
        groups[k % 3].Take(records[k].first, records[k].second);
      }
    }
    LayerControls together = groups[2];
    together.Take(groups[0]);
    together.Take(groups[1]);
    ASSERT_EQ(together, all);
    ASSERT_EQ(together.hash(), all.hash());
    EXPECT_FALSE(together.Take(all));
  }
}

TEST(LayerControlsTest, ARemovalCannotBeUndoneAndTakesTheWholeGeneration) {
  const LayerId id{"robot", 1};
  LayerControls controls;
  const LayerControl removal = controls.Removal(id, 5, 10);
  LayerControl mute = controls.Next(id, 20);  // by somebody who has not heard of it
  mute.muted = true;
  controls.Take(id, removal);
  controls.Take(id, mute);
  EXPECT_TRUE(controls.Of(id).muted);
  EXPECT_TRUE(controls.Of(id).IsRemoved({6, 1})) << "a start with what was removed";
  EXPECT_FALSE(controls.Of(id).IsRemoved({LayerControl::kStartsPerGeneration, 1}));
  EXPECT_TRUE(controls.Of(id).IsValid());
}

TEST(LayerControlsTest, RecordsAreBounded) {
  LayerControls controls;
  for (uint64_t n = 0; n < LayerControls::kMax; ++n) {
    EXPECT_TRUE(controls.Take({"robot", n}, controls.Next({"robot", n}, 1)));
  }
  EXPECT_FALSE(controls.Take({"robot", 5000}, controls.Next({"robot", 5000}, 1)));
  EXPECT_EQ(controls.records().size(), LayerControls::kMax);
  LayerControl bad;
  bad.shift = {KnotShift::kMax + 1, 0};
  EXPECT_FALSE(bad.IsValid());
  bad = {};
  bad.alignment[1] = std::nan("");
  EXPECT_FALSE(bad.IsValid());
}

}  // namespace splinemap::merged_tiles_test
