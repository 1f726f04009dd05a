#include "lib/layers/layer_union.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <map>
#include <memory>
#include <random>
#include <utility>
#include <vector>

#include "lib/layers/layer_edits.h"
#include "lib/map/flattened.h"
#include "lib/map/summed_layers.h"
#include "splinemap/scan_archive.h"
#include "tests/support/map_writer.h"
#include "tests/support/placement.h"
#include "tests/support/random_map.h"

namespace splinemap::layer_union_test {

constexpr MapOptions kOptions{0.1, {-2560, 2560}};

using Random = std::mt19937_64;
using Tiles = std::map<TileKey, std::pair<uint64_t, Tile>>;

Tiles TilesOf(const TileTree& tree) {
  Tiles tiles;
  tree.ForEach([&](TileKey key, const TileTree::Entry& entry) {
    tiles[key] = {entry.revision, *entry.tile->Get()};
  });
  return tiles;
}

// The sum has no revisions of its own.
std::map<TileKey, Tile> SumOf(const LayerSet& set) {
  std::map<TileKey, Tile> sum;
  ViewOf(set)->tiles.ForEach(
      [&](TileKey key, const TileTree::Entry& entry) { sum[key] = *entry.tile->Get(); });
  return sum;
}

void ExpectEqualLayers(const LayerSet& a, const LayerSet& b) {
  ASSERT_EQ(a.layers.size(), b.layers.size());
  for (size_t k = 0; k < a.layers.size(); ++k) {
    EXPECT_EQ(a.layers[k].id, b.layers[k].id);
    EXPECT_EQ(a.layers[k].session, b.layers[k].session);
    EXPECT_EQ(a.layers[k].revision, b.layers[k].revision);
    EXPECT_EQ(TilesOf(a.layers[k].tiles), TilesOf(b.layers[k].tiles));
  }
  EXPECT_EQ(SumOf(a), SumOf(b));
}

void ExpectEqual(const LayerSet& a, const LayerSet& b) {
  EXPECT_EQ(a.options, b.options);
  EXPECT_EQ(a.settings, b.settings);
  EXPECT_EQ(a.own_layer, b.own_layer);
  ExpectEqualLayers(a, b);
}

LayerSet Merged(const std::vector<LayerSet>& maps) {
  LayerUnion layer_union(kOptions);
  for (const LayerSet& map : maps) EXPECT_TRUE(layer_union.Add(map).ok());
  return layer_union.Layers();
}

// Robots and people, who save maps as they go: of one robot, of several, older and newer ones.
class LayerUnionTest : public testing::Test {
 protected:
  Layer& LayerOf(uint64_t robot) {
    std::unique_ptr<Layer>& layer = layers_[robot];
    if (!layer) {
      const LayerId id{robot % 2 == 0 ? "even" : "odd", robot};
      layer = std::make_unique<Layer>(id, SessionId{1, random_()});
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
    const SessionId next{layer.session().number + 1, random_()};
    switch (random_() % 12) {
      case 0:
        layer.StartSession(layer.id(), next);
        break;
      case 1:
        layer.StartEmptySession(next);
        break;
      case 2: {
        const uint64_t writer = random_();
        LayerSettings setting = settings_.Next(layer.id(), writer);
        setting.muted = random_() % 2 == 0;
        setting.placement = PlacedAt(int32_t(random_() % 3), 0, int32_t(random_() % 3) * 20);
        settings_.Merge(layer.id(), setting);
        break;
      }
      case 3:
        if (random_() % 4 != 0) break;
        settings_.Merge(layer.id(), settings_.Removal(layer.id(), layer.session(), random_()));
        if (random_() % 2 == 0) {  // and heard of it
          layer.StartEmptySession({settings_.Of(layer.id()).removed_up_to + 1, random_()});
        }
        break;
      default:
        Commit(robot);
    }
  }

  // Some of the layers as they are, and what some have heard of the records.
  LayerSet Save() {
    MapWriter map(kOptions);
    for (auto& [robot, layer] : layers_) {
      if (random_() % 2 == 0) map.ContinueLayer(layer->Snapshot(), layer->session());
    }
    if (random_() % 2 == 0 && !map.layers().empty()) map.SetOwnLayer(map.layers().back().id());
    SettingsTable some;
    for (const auto& [id, setting] : settings_.records()) {
      if (random_() % 2 == 0) some.Merge(id, setting);
    }
    map.SetSettings(some);
    return map.Layers();
  }

  // What another daemon of a copied file has: other tiles in the same session, or a session beside
  // it.
  LayerSet Clone(const LayerSet& map) {
    MapWriter clone(kOptions);
    for (const LayerSnapshot& layer : map.layers) {
      SessionId session = layer.session;
      if (random_() % 4 == 0) session.nonce = random_();
      Layer& copy = clone.AddLayer(layer.id, session);
      copy.RestoreRevision(layer.revision);
      layer.tiles.ForEach([&](TileKey key, const TileTree::Entry& entry) {
        Tile tile = *entry.tile->Get();
        if (random_() % 3 == 0) tile = RandomTile(random_, kOptions.limits);
        copy.RestoreTile(key, std::make_shared<const StoredTile>(tile), entry.revision);
      });
    }
    clone.SetSettings(map.settings);
    return clone.Layers();
  }

  // A merge as people do it: some of the files, then that with others.
  LayerSet MergedInGroups(std::vector<LayerSet> maps) {
    std::shuffle(maps.begin(), maps.end(), random_);
    while (maps.size() > 1) {
      const size_t count = 1 + random_() % maps.size();
      std::vector<LayerSet> group(maps.end() - count, maps.end());
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
  SettingsTable settings_;
};

TEST_F(LayerUnionTest, AnyOrderGroupingAndRepetitionGivesTheSameBytes) {
  int conflicting_tiles = 0;
  int removed = 0;
  int replaced = 0;
  for (int round = 0; round < 40; ++round) {
    layers_.clear();
    settings_ = {};
    std::vector<LayerSet> maps;
    for (int step = 0; step < 60; ++step) {
      Step();
      if (step % 8 == 7) maps.push_back(Save());
    }
    if (round % 3 == 0) maps.push_back(Clone(maps[random_() % maps.size()]));
    LayerUnion layer_union(kOptions);
    for (const LayerSet& map : maps) {
      const auto conflicts = layer_union.Add(map);
      ASSERT_TRUE(conflicts.ok());
      for (const LayerUnion::Conflict& conflict : *conflicts) {
        conflicting_tiles += conflict.conflicting_tiles > 0 ? 1 : 0;
        replaced += conflict.kept != conflict.dropped ? 1 : 0;
      }
    }
    removed += static_cast<int>(layer_union.Removed().size());
    const LayerSet expected = layer_union.Layers();
    EXPECT_FALSE(expected.own_layer);
    for (int n = 0; n < 6; ++n) {
      ExpectEqual(MergedInGroups(maps), expected);
      ASSERT_FALSE(HasFailure()) << "round " << round;
    }
  }
  EXPECT_GT(conflicting_tiles, 0);
  EXPECT_GT(removed, 0);
  EXPECT_GT(replaced, 0);
}

// The definition, by looking at every map for every layer.
TEST_F(LayerUnionTest, HasOfEveryLayerTheNewestStateThatAMapHas) {
  for (int round = 0; round < 20; ++round) {
    layers_.clear();
    settings_ = {};
    std::vector<LayerSet> maps;
    for (int step = 0; step < 60; ++step) {
      Step();
      if (step % 8 == 7) maps.push_back(Save());
    }
    const LayerSet merged = Merged(maps);
    std::map<LayerId, LayerSnapshot> newest;
    for (const LayerSet& map : maps) {
      for (const LayerSnapshot& layer : map.layers) {
        LayerSnapshot& best = newest.try_emplace(layer.id, layer).first->second;
        if (std::pair(layer.session, layer.revision) > std::pair(best.session, best.revision)) {
          best = layer;
        }
      }
      for (const auto& [id, setting] : map.settings.records()) {
        EXPECT_EQ(Merge(merged.settings.Of(id), setting), merged.settings.Of(id));
      }
    }
    std::erase_if(newest, [&](const auto& entry) {
      return merged.settings.Of(entry.first).IsRemoved(entry.second.session);
    });
    MapWriter expected(kOptions);
    for (const auto& [id, layer] : newest) expected.ContinueLayer(layer, layer.session);
    expected.SetSettings(merged.settings);
    ExpectEqual(merged, expected.Layers());
  }
}

TEST_F(LayerUnionTest, PartsOfOneLayerMakeTheWhole) {
  for (int n = 0; n < 20; ++n) Commit(1);
  const LayerSnapshot whole = LayerOf(1).Snapshot();
  std::vector<LayerSet> parts;
  for (int part = 0; part < 3; ++part) {
    MapWriter map(kOptions);
    Layer& layer = map.AddLayer(whole.id, whole.session);
    whole.tiles.ForEach([&](TileKey key, const TileTree::Entry& entry) {
      if ((key.tx + 3) % 3 == part) layer.RestoreTile(key, entry.tile, entry.revision);
    });
    parts.push_back(map.Layers());
  }
  const LayerSet merged = Merged(parts);
  ASSERT_EQ(merged.layers.size(), 1u);
  EXPECT_EQ(TilesOf(merged.layers[0].tiles), TilesOf(whole.tiles));
  EXPECT_EQ(merged.layers[0].revision, whole.revision);
}

TEST_F(LayerUnionTest, TheGreaterSessionReplacesTheLayerAsAWhole) {
  for (int n = 0; n < 20; ++n) Commit(1);
  MapWriter before(kOptions);
  before.ContinueLayer(LayerOf(1).Snapshot(), LayerOf(1).session());
  LayerOf(1).StartEmptySession({2, 1});
  LayerOf(1).BeginCommit();
  LayerOf(1).EditTile({50, 50}).control_points.fill(3);
  MapWriter after(kOptions);
  after.ContinueLayer(LayerOf(1).Snapshot(), LayerOf(1).session());
  LayerUnion layer_union(kOptions);
  EXPECT_TRUE(layer_union.Add(after.Layers())->empty());
  const auto conflicts = layer_union.Add(before.Layers());
  ASSERT_EQ(conflicts->size(), 1u);
  EXPECT_EQ(conflicts->front().kept, (SessionId{2, 1}));
  EXPECT_EQ(conflicts->front().dropped.number, 1u);
  EXPECT_FALSE(conflicts->front().is_map_newer);
  EXPECT_EQ(conflicts->front().conflicting_tiles, 0);
  LayerUnion in_order(kOptions);
  EXPECT_TRUE(in_order.Add(before.Layers())->empty());
  EXPECT_TRUE(in_order.Add(after.Layers())->front().is_map_newer);
  ExpectEqual(layer_union.Layers(), after.Layers());
}

TEST_F(LayerUnionTest, ContentsOfOneRevisionThatDifferAreCounted) {
  Commit(1);
  MapWriter map(kOptions);
  map.ContinueLayer(LayerOf(1).Snapshot(), LayerOf(1).session());
  const LayerSet one = map.Layers();
  LayerSet other = Clone(one);
  while (other.layers[0].session != one.layers[0].session) other = Clone(one);
  LayerUnion layer_union(kOptions);
  EXPECT_TRUE(layer_union.Add(one)->empty());
  EXPECT_TRUE(layer_union.Add(one)->empty());
  int64_t differ = 0;
  for (const auto& [key, tile] : TilesOf(one.layers[0].tiles)) {
    differ += *FindTile(other.layers[0].tiles, key) != tile.second ? 1 : 0;
  }
  ASSERT_GT(differ, 0);
  const auto conflicts = layer_union.Add(other);
  ASSERT_EQ(conflicts->size(), 1u);
  EXPECT_EQ(conflicts->front().conflicting_tiles, differ);
  EXPECT_EQ(conflicts->front().kept, conflicts->front().dropped);
}

// Of two files of one session the later has all scans.
TEST_F(LayerUnionTest, TheScansOfTheOneThatHasAllTilesAreKept) {
  const auto tile = std::make_shared<const StoredTile>(RandomTile(random_));
  Layer layer(LayerId{"robot", 1}, {1, 1});
  layer.RestoreTile({0, 0}, tile, 1);
  LayerSnapshot before = layer.Snapshot();
  layer.RestoreTile({1, 0}, tile, 2);
  LayerSnapshot after = layer.Snapshot();
  before.archive = std::make_shared<ScanArchive>();
  after.archive = std::make_shared<ScanArchive>();
  int64_t conflicts = 0;
  EXPECT_EQ(Merge(before, after, conflicts).archive, after.archive);
  EXPECT_EQ(Merge(after, before, conflicts).archive, after.archive);
  Layer part(LayerId{"robot", 1}, {1, 1});
  part.RestoreTile({2, 0}, tile, 2);
  LayerSnapshot other = part.Snapshot();
  other.archive = before.archive;
  EXPECT_EQ(Merge(after, other, conflicts).archive, nullptr) << "neither has all";
}

TEST_F(LayerUnionTest, AMapWithoutALayerIsAsIfItHadNeverBeenAndItStaysAway) {
  for (int n = 0; n < 40; ++n) Commit(random_() % 4);
  MapWriter all(kOptions);
  MapWriter others(kOptions);
  for (auto& [robot, layer] : layers_) {
    all.ContinueLayer(layer->Snapshot(), layer->session());
    if (robot != 2) others.ContinueLayer(layer->Snapshot(), layer->session());
  }
  const LayerId removed = LayerOf(2).id();
  all.SetOwnLayer(LayerOf(3).id());
  const auto rest = WithoutLayers(all.Layers(), {removed}, 77);
  ASSERT_TRUE(rest.ok());
  ExpectEqualLayers(*rest, others.Layers());
  EXPECT_EQ(rest->own_layer, LayerOf(3).id());
  ExpectEqualLayers(Merged({all.Layers(), *rest}), others.Layers());
  ExpectEqualLayers(Merged({*rest, all.Layers(), all.Layers()}), others.Layers());
  // Nor does what its robot, who has not heard of it, measures after further starts.
  LayerOf(2).StartSession(removed, {5, 1});
  Commit(2);
  MapWriter later(kOptions);
  later.ContinueLayer(LayerOf(2).Snapshot(), LayerOf(2).session());
  ExpectEqualLayers(Merged({*rest, later.Layers()}), others.Layers());
  // What it begins in the next generation does.
  LayerOf(2).StartEmptySession({LayerSettings::kSessionsPerGeneration, 1});
  Commit(2);
  MapWriter anew(kOptions);
  anew.ContinueLayer(LayerOf(2).Snapshot(), LayerOf(2).session());
  EXPECT_EQ(Merged({all.Layers(), *rest, anew.Layers()}).layers.size(), 4u);
  // Its own layer is not one of the map any more.
  all.SetOwnLayer(removed);
  EXPECT_FALSE(WithoutLayers(all.Layers(), {removed}, 77)->own_layer);
}

TEST_F(LayerUnionTest, RecordsThatHaveNoRoomAreRefusedAndChangeNothing) {
  const auto with_records = [](uint64_t begin, uint64_t end) {
    MapWriter map(kOptions);
    map.AddLayer({"robot", begin}, {1, 1});
    SettingsTable settings;
    for (uint64_t n = begin; n < end; ++n) {
      settings.Merge({"robot", n}, settings.Next({"robot", n}, 1));
    }
    map.SetSettings(settings);
    return map.Layers();
  };
  const LayerSet full = with_records(0, SettingsTable::kMax);
  LayerUnion layer_union(kOptions);
  ASSERT_TRUE(layer_union.Add(full).ok());
  EXPECT_FALSE(layer_union.Add(with_records(5000, 5001)).ok());
  ExpectEqual(layer_union.Layers(), full);
  EXPECT_TRUE(layer_union.Add(with_records(7, 9)).ok());

  MapWriter map(kOptions);
  map.AddLayer({"other", 1}, {1, 1});
  map.SetSettings(full.settings);
  EXPECT_FALSE(WithoutLayers(map.Layers(), {{"other", 1}}, 1).ok());
  MapWriter hostile(kOptions);
  hostile.AddLayer({"robot", 1}, {SessionId::kMaxNumber + 1, 1});
  EXPECT_FALSE(WithoutLayers(hostile.Layers(), {{"robot", 1}}, 1).ok());
}

TEST_F(LayerUnionTest, AFlatMapIsTheSumInOneLayer) {
  for (int n = 0; n < 60; ++n) Commit(random_() % 4);
  LayerSettings muted = settings_.Next(LayerOf(0).id(), 1);
  muted.muted = true;
  settings_.Merge(LayerOf(0).id(), muted);
  LayerSettings placed = settings_.Next(LayerOf(1).id(), 1);
  placed.placement = PlacedAt(0.35, -2, 100);
  settings_.Merge(LayerOf(1).id(), placed);
  MapWriter map(kOptions);
  for (auto& [robot, layer] : layers_) map.ContinueLayer(layer->Snapshot(), layer->session());
  map.SetSettings(settings_);
  const LayerSet flat = Flattened(map.Layers(), {"flat", 9}, {1, 4});
  ASSERT_EQ(flat.layers.size(), 1u);
  EXPECT_EQ(flat.layers[0].id, (LayerId{"flat", 9}));
  EXPECT_EQ(flat.layers[0].revision,
            LayerOf(1).revision() + LayerOf(2).revision() + LayerOf(3).revision());
  EXPECT_TRUE(flat.settings.records().empty());
  EXPECT_EQ(SumOf(flat), SumOf(map.Layers()));
  for (const auto& [key, tile] : TilesOf(flat.layers[0].tiles)) {
    EXPECT_EQ(tile.first, flat.layers[0].revision);
  }
}

}  // namespace splinemap::layer_union_test
