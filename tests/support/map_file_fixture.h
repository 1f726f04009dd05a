#pragma once

#include <gtest/gtest.h>

#include <map>
#include <string>
#include <utility>

#include "lib/map/summed_layers.h"
#include "splinemap/layer_set.h"
#include "tests/support/map_writer.h"
#include "tests/support/temporary_directory.h"

namespace splinemap {

using Content = std::map<std::pair<int, int>, std::pair<Tile, uint64_t>>;

inline Content ContentOf(const TileTree& tree) {
  Content content;
  tree.ForEach([&](TileKey key, const TileTree::Entry& entry) {
    content[{key.tx, key.ty}] = {*entry.tile->Get(), entry.revision};
  });
  return content;
}

class MapFileTest : public testing::Test {
 protected:
  // One commit on a few tiles, each set to `value` throughout.
  static void Commit(Layer& layer, ControlPoint value) {
    layer.BeginCommit();
    for (int k = -3; k < 4; ++k) layer.EditTile({k, value % 3}).control_points.fill(value);
  }

  static void ExpectEqual(const LayerSet& a, const LayerSet& b) {
    EXPECT_EQ(a.options, b.options);
    EXPECT_EQ(a.settings, b.settings);
    EXPECT_EQ(a.own_layer, b.own_layer);
    EXPECT_EQ(ContentOf(ViewOf(a)->tiles), ContentOf(ViewOf(b)->tiles));
    ASSERT_EQ(a.layers.size(), b.layers.size());
    for (size_t k = 0; k < a.layers.size(); ++k) {
      EXPECT_EQ(a.layers[k].id, b.layers[k].id);
      EXPECT_EQ(a.layers[k].session, b.layers[k].session);
      EXPECT_EQ(a.layers[k].revision, b.layers[k].revision);
      EXPECT_EQ(ContentOf(a.layers[k].tiles), ContentOf(b.layers[k].tiles));
    }
  }

  TemporaryDirectory directory_;
  std::string path_ = directory_.File("map.splinemap");
  MapWriter map_{{0.1, {-2560, 5120}}};
};

}  // namespace splinemap
