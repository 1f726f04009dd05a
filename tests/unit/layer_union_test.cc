#include "lib/map/layer_union.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <map>
#include <memory>
#include <random>
#include <utility>
#include <vector>

#include "lib/map/map_edits.h"
#include "tests/support/random_map.h"

namespace splinemap::layer_union_test {

constexpr MapOptions kOptions{0.1, {-2560, 2560}};

using Random = std::mt19937_64;
using MapPointer = std::shared_ptr<const MapSnapshot>;
using Tiles = std::map<TileKey, std::pair<uint64_t, Tile>>;

Tiles TilesOf(const TileTree& tree) {
  Tiles tiles;
  tree.ForEach([&](TileKey key, const TileTree::Entry& entry) {
    tiles[key] = {entry.revision, *entry.tile};
  });
  return tiles;
}

// The sum has no revisions of its own.
std::map<TileKey, Tile> SumOf(const MapSnapshot& map) {
  std::map<TileKey, Tile> sum;
  map.merged.ForEach([&](TileKey key, const TileTree::Entry& entry) { sum[key] = *entry.tile; });
  return sum;
}

void ExpectEqualLayers(const MapSnapshot& a, const MapSnapshot& b) {
  ASSERT_EQ(a.layers.size(), b.layers.size());
  for (size_t k = 0; k < a.layers.size(); ++k) {
    EXPECT_EQ(a.layers[k].id, b.layers[k].id);
    EXPECT_EQ(a.layers[k].epoch, b.layers[k].epoch);
    EXPECT_EQ(a.layers[k].revision, b.layers[k].revision);
    EXPECT_EQ(TilesOf(a.layers[k].tiles), TilesOf(b.layers[k].tiles));
  }
  EXPECT_EQ(SumOf(a), SumOf(b));
}

void ExpectEqual(const MapSnapshot& a, const MapSnapshot& b) {
  EXPECT_EQ(a.options, b.options);
  EXPECT_EQ(a.controls, b.controls);
  EXPECT_EQ(a.own_layer, b.own_layer);
  ExpectEqualLayers(a, b);
}

MapPointer Merged(const std::vector<MapPointer>& maps) {
  LayerUnion layer_union(kOptions);
  for (const MapPointer& map : maps) EXPECT_TRUE(layer_union.Take(*map).ok());
  return layer_union.Snapshot();
}

// Robots and people, who save maps as they go: of one robot, of several, older and newer ones.
class LayerUnionTest : public testing::Test {
 protected:
  Layer& LayerOf(uint64_t robot) {
    std::unique_ptr<Layer>& layer = layers_[robot];
    if (!layer) {
      const LayerId id{robot % 2 == 0 ? "even" : "odd", robot};
      layer = std::make_unique<Layer>(id, LayerEpoch{1, random_()});
    }
    return *layer;
  }

  void Commit(uint64_t robot) {
    Layer& layer = LayerOf(robot);
    layer.BeginCommit();
    for (int n = 0; n < 3; ++n) {
      layer.EditTile(RandomKey(random_, 1)) = RandomTile(random_, kOptions.limits);
    }
  }

  void Step() {
    const uint64_t robot = random_() % 4;
    Layer& layer = LayerOf(robot);
    const LayerEpoch next{layer.epoch().incarnation + 1, random_()};
    switch (random_() % 12) {
      case 0:
        layer.BeginLife(layer.id(), next);
        break;
      case 1:
        layer.BeginEmptyLife(next);
        break;
      case 2: {
        const uint64_t writer = random_();
        LayerControl control = controls_.Next(layer.id(), writer);
        control.muted = random_() % 2 == 0;
        control.shift = {int32_t(random_() % 3) * 20, 0};
        controls_.Take(layer.id(), control);
        break;
      }
      case 3:
        if (random_() % 4 != 0) break;
        controls_.Take(layer.id(),
                       controls_.Removal(layer.id(), layer.epoch().incarnation, random_()));
        if (random_() % 2 == 0) {  // and heard of it
          layer.BeginEmptyLife({controls_.Of(layer.id()).removed_up_to + 1, random_()});
        }
        break;
      default:
        Commit(robot);
    }
  }

  // Some of the layers as they are, and what some have heard of the records.
  MapPointer Save() {
    Map map(kOptions);
    for (auto& [robot, layer] : layers_) {
      if (random_() % 2 == 0) map.ContinueLayer(layer->Snapshot(), layer->epoch());
    }
    if (random_() % 2 == 0 && !map.layers().empty()) map.SetOwnLayer(map.layers().back().id());
    LayerControls some;
    for (const auto& [id, control] : controls_.records()) {
      if (random_() % 2 == 0) some.Take(id, control);
    }
    map.SetControls(some);
    return map.Snapshot();
  }

  // What another daemon of a copied file has: other tiles in the same life, or a life beside it.
  MapPointer Clone(const MapPointer& map) {
    Map clone(kOptions);
    for (const LayerSnapshot& layer : map->layers) {
      LayerEpoch epoch = layer.epoch;
      if (random_() % 4 == 0) epoch.nonce = random_();
      Layer& copy = clone.AddLayer(layer.id, epoch);
      copy.RestoreRevision(layer.revision);
      layer.tiles.ForEach([&](TileKey key, const TileTree::Entry& entry) {
        auto tile = std::make_shared<Tile>(*entry.tile);
        if (random_() % 3 == 0) *tile = RandomTile(random_, kOptions.limits);
        copy.RestoreTile(key, tile, entry.revision);
      });
    }
    clone.SetControls(map->controls);
    return clone.Snapshot();
  }

  // A merge as people do it: some of the files, then that with others.
  MapPointer MergedInGroups(std::vector<MapPointer> maps) {
    std::shuffle(maps.begin(), maps.end(), random_);
    while (maps.size() > 1) {
      const size_t count = 1 + random_() % maps.size();
      std::vector<MapPointer> group(maps.end() - count, maps.end());
      if (random_() % 4 == 0) group.push_back(group.front());
      maps.resize(maps.size() - count);
      maps.push_back(Merged(group));
      if (random_() % 4 == 0) maps.push_back(maps.front());  // once more
      std::shuffle(maps.begin(), maps.end(), random_);
      if (count == 1 && maps.size() > 20) maps.resize(20);
    }
    return maps.front();
  }

  Random random_{5};
  std::map<uint64_t, std::unique_ptr<Layer>> layers_;
  LayerControls controls_;
};

TEST_F(LayerUnionTest, AnyOrderGroupingAndRepetitionGivesTheSameBytes) {
  int contradictions = 0;
  int removed = 0;
  int replaced = 0;
  for (int round = 0; round < 40; ++round) {
    layers_.clear();
    controls_ = {};
    std::vector<MapPointer> maps;
    for (int step = 0; step < 60; ++step) {
      Step();
      if (step % 8 == 7) maps.push_back(Save());
    }
    if (round % 3 == 0) maps.push_back(Clone(maps[random_() % maps.size()]));
    LayerUnion layer_union(kOptions);
    for (const MapPointer& map : maps) {
      const auto clashes = layer_union.Take(*map);
      ASSERT_TRUE(clashes.ok());
      for (const LayerUnion::Clash& clash : *clashes) {
        contradictions += clash.contradictions > 0 ? 1 : 0;
        replaced += clash.kept != clash.dropped ? 1 : 0;
      }
    }
    removed += static_cast<int>(layer_union.Removed().size());
    const MapPointer expected = layer_union.Snapshot();
    EXPECT_FALSE(expected->own_layer);
    for (int n = 0; n < 6; ++n) {
      ExpectEqual(*MergedInGroups(maps), *expected);
      ASSERT_FALSE(HasFailure()) << "round " << round;
    }
  }
  EXPECT_GT(contradictions, 0);
  EXPECT_GT(removed, 0);
  EXPECT_GT(replaced, 0);
}

// The definition, by looking at every map for every layer.
TEST_F(LayerUnionTest, HasOfEveryLayerTheNewestStateThatAMapHas) {
  for (int round = 0; round < 20; ++round) {
    layers_.clear();
    controls_ = {};
    std::vector<MapPointer> maps;
    for (int step = 0; step < 60; ++step) {
      Step();
      if (step % 8 == 7) maps.push_back(Save());
    }
    const MapPointer merged = Merged(maps);
    std::map<LayerId, LayerSnapshot> newest;
    for (const MapPointer& map : maps) {
      for (const LayerSnapshot& layer : map->layers) {
        LayerSnapshot& best = newest.try_emplace(layer.id, layer).first->second;
        if (std::pair(layer.epoch, layer.revision) > std::pair(best.epoch, best.revision)) {
          best = layer;
        }
      }
      for (const auto& [id, control] : map->controls.records()) {
        EXPECT_EQ(Merge(merged->controls.Of(id), control), merged->controls.Of(id));
      }
    }
    std::erase_if(newest, [&](const auto& entry) {
      return merged->controls.Of(entry.first).IsRemoved(entry.second.epoch);
    });
    Map expected(kOptions);
    for (const auto& [id, layer] : newest) expected.ContinueLayer(layer, layer.epoch);
    expected.SetControls(merged->controls);
    ExpectEqual(*merged, *expected.Snapshot());
  }
}

TEST_F(LayerUnionTest, PartsOfOneLayerMakeTheWhole) {
  for (int n = 0; n < 20; ++n) Commit(1);
  const LayerSnapshot whole = LayerOf(1).Snapshot();
  std::vector<MapPointer> parts;
  for (int part = 0; part < 3; ++part) {
    Map map(kOptions);
    Layer& layer = map.AddLayer(whole.id, whole.epoch);
    whole.tiles.ForEach([&](TileKey key, const TileTree::Entry& entry) {
      if ((key.tx + 3) % 3 == part) layer.RestoreTile(key, entry.tile, entry.revision);
    });
    parts.push_back(map.Snapshot());
  }
  const MapPointer merged = Merged(parts);
  ASSERT_EQ(merged->layers.size(), 1u);
  EXPECT_EQ(TilesOf(merged->layers[0].tiles), TilesOf(whole.tiles));
  EXPECT_EQ(merged->layers[0].revision, whole.revision);
}

TEST_F(LayerUnionTest, TheGreaterEpochReplacesTheLayerAsAWhole) {
  for (int n = 0; n < 20; ++n) Commit(1);
  Map before(kOptions);
  before.ContinueLayer(LayerOf(1).Snapshot(), LayerOf(1).epoch());
  LayerOf(1).BeginEmptyLife({2, 1});
  LayerOf(1).BeginCommit();
  LayerOf(1).EditTile({50, 50}).control_points.fill(3);
  Map after(kOptions);
  after.ContinueLayer(LayerOf(1).Snapshot(), LayerOf(1).epoch());
  LayerUnion layer_union(kOptions);
  EXPECT_TRUE(layer_union.Take(*after.Snapshot())->empty());
  const auto clashes = layer_union.Take(*before.Snapshot());
  ASSERT_EQ(clashes->size(), 1u);
  EXPECT_EQ(clashes->front().kept, (LayerEpoch{2, 1}));
  EXPECT_EQ(clashes->front().dropped.incarnation, 1u);
  EXPECT_FALSE(clashes->front().is_map_newer);
  EXPECT_EQ(clashes->front().contradictions, 0);
  LayerUnion in_order(kOptions);
  EXPECT_TRUE(in_order.Take(*before.Snapshot())->empty());
  EXPECT_TRUE(in_order.Take(*after.Snapshot())->front().is_map_newer);
  ExpectEqual(*layer_union.Snapshot(), *after.Snapshot());
}

TEST_F(LayerUnionTest, ContentsOfOneRevisionThatDifferAreCounted) {
  Commit(1);
  Map map(kOptions);
  map.ContinueLayer(LayerOf(1).Snapshot(), LayerOf(1).epoch());
  const MapPointer one = map.Snapshot();
  MapPointer other = Clone(one);
  while (other->layers[0].epoch != one->layers[0].epoch) other = Clone(one);
  LayerUnion layer_union(kOptions);
  EXPECT_TRUE(layer_union.Take(*one)->empty());
  EXPECT_TRUE(layer_union.Take(*one)->empty());
  int64_t differ = 0;
  for (const auto& [key, tile] : TilesOf(one->layers[0].tiles)) {
    differ += *other->layers[0].tiles.Find(key) != tile.second ? 1 : 0;
  }
  ASSERT_GT(differ, 0);
  const auto clashes = layer_union.Take(*other);
  ASSERT_EQ(clashes->size(), 1u);
  EXPECT_EQ(clashes->front().contradictions, differ);
  EXPECT_EQ(clashes->front().kept, clashes->front().dropped);
}

TEST_F(LayerUnionTest, AMapWithoutALayerIsAsIfItHadNeverBeenAndItStaysAway) {
  for (int n = 0; n < 40; ++n) Commit(random_() % 4);
  Map all(kOptions);
  Map others(kOptions);
  for (auto& [robot, layer] : layers_) {
    all.ContinueLayer(layer->Snapshot(), layer->epoch());
    if (robot != 2) others.ContinueLayer(layer->Snapshot(), layer->epoch());
  }
  const LayerId removed = LayerOf(2).id();
  all.SetOwnLayer(LayerOf(3).id());
  const auto rest = WithoutLayers(*all.Snapshot(), {removed}, 77);
  ASSERT_TRUE(rest.ok());
  ExpectEqualLayers(**rest, *others.Snapshot());
  EXPECT_EQ((*rest)->own_layer, LayerOf(3).id());
  ExpectEqualLayers(*Merged({all.Snapshot(), *rest}), *others.Snapshot());
  ExpectEqualLayers(*Merged({*rest, all.Snapshot(), all.Snapshot()}), *others.Snapshot());
  // Nor does what its robot, who has not heard of it, measures after further starts.
  LayerOf(2).BeginLife(removed, {5, 1});
  Commit(2);
  Map later(kOptions);
  later.ContinueLayer(LayerOf(2).Snapshot(), LayerOf(2).epoch());
  ExpectEqualLayers(*Merged({*rest, later.Snapshot()}), *others.Snapshot());
  // What it begins in the next generation does.
  LayerOf(2).BeginEmptyLife({LayerControl::kStartsPerGeneration, 1});
  Commit(2);
  Map anew(kOptions);
  anew.ContinueLayer(LayerOf(2).Snapshot(), LayerOf(2).epoch());
  EXPECT_EQ(Merged({all.Snapshot(), *rest, anew.Snapshot()})->layers.size(), 4u);
  // Its own layer is not one of the map any more.
  all.SetOwnLayer(removed);
  EXPECT_FALSE((*WithoutLayers(*all.Snapshot(), {removed}, 77))->own_layer);
}

TEST_F(LayerUnionTest, RecordsThatHaveNoRoomAreRefusedAndChangeNothing) {
  const auto with_records = [](uint64_t begin, uint64_t end) {
    Map map(kOptions);
    map.AddLayer({"robot", begin}, {1, 1});
    LayerControls controls;
    for (uint64_t n = begin; n < end; ++n) {
      controls.Take({"robot", n}, controls.Next({"robot", n}, 1));
    }
    map.SetControls(controls);
    return map.Snapshot();
  };
  const MapPointer full = with_records(0, LayerControls::kMax);
  LayerUnion layer_union(kOptions);
  ASSERT_TRUE(layer_union.Take(*full).ok());
  EXPECT_FALSE(layer_union.Take(*with_records(5000, 5001)).ok());
  ExpectEqual(*layer_union.Snapshot(), *full);
  EXPECT_TRUE(layer_union.Take(*with_records(7, 9)).ok());

  Map map(kOptions);
  map.AddLayer({"other", 1}, {1, 1});
  map.SetControls(full->controls);
  EXPECT_FALSE(WithoutLayers(*map.Snapshot(), {{"other", 1}}, 1).ok());
  Map hostile(kOptions);
  hostile.AddLayer({"robot", 1}, {LayerEpoch::kMaxIncarnation + 1, 1});
  EXPECT_FALSE(WithoutLayers(*hostile.Snapshot(), {{"robot", 1}}, 1).ok());
}

TEST_F(LayerUnionTest, AFlatMapIsTheSumInOneLayer) {
  for (int n = 0; n < 60; ++n) Commit(random_() % 4);
  LayerControl muted = controls_.Next(LayerOf(0).id(), 1);
  muted.muted = true;
  controls_.Take(LayerOf(0).id(), muted);
  LayerControl shifted = controls_.Next(LayerOf(1).id(), 1);
  shifted.shift = {7, -40};
  controls_.Take(LayerOf(1).id(), shifted);
  Map map(kOptions);
  for (auto& [robot, layer] : layers_) map.ContinueLayer(layer->Snapshot(), layer->epoch());
  map.SetControls(controls_);
  const MapPointer flat = Flattened(*map.Snapshot(), {"flat", 9}, {1, 4});
  ASSERT_EQ(flat->layers.size(), 1u);
  EXPECT_EQ(flat->layers[0].id, (LayerId{"flat", 9}));
  EXPECT_EQ(flat->layers[0].revision,
            LayerOf(1).revision() + LayerOf(2).revision() + LayerOf(3).revision());
  EXPECT_TRUE(flat->controls.records().empty());
  EXPECT_EQ(SumOf(*flat), SumOf(*map.Snapshot()));
  for (const auto& [key, tile] : TilesOf(flat->layers[0].tiles)) {
    EXPECT_EQ(tile.first, flat->layers[0].revision);
  }
}

}  // namespace splinemap::layer_union_test
