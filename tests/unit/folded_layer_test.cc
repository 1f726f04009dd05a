#include "services/splinemapd/folded_layer.h"

#include <gtest/gtest.h>

#include <filesystem>
#include <memory>

#include "lib/tiles/spill_file.h"
#include "tests/support/temporary_directory.h"

namespace splinemap::folded_layer_test {

// A scan of the `k`-th second from the middle of a round room, along which the robot moves.
std::shared_ptr<const PosedScan> ScanAt(int k) {
  auto scan = std::make_shared<PosedScan>();
  scan->utime = std::chrono::seconds(k);
  scan->world_T_robot = FixedPose2::Nearest({{0.01 * k, 0}, 0.002 * k});
  scan->robot_T_sensor.resize(1);
  for (int n = 0; n < 60; ++n) {
    scan->beams.push_back(
        {2.5F, 0.1F * static_cast<float>(n), Utime(0), true, static_cast<uint16_t>(n)});
  }
  return scan;
}

void AddScans(int from, int to, ScanArchive& archive) {
  for (int k = from; k < to; ++k) archive.Add(ScanAt(k), {});
}

// Moves all scans, leaves some out, and places the layer.
ArchiveEdit AnyEdit() {
  ArchiveEdit edit;
  edit.is_kept = [](const ScanPose& pose) { return pose.utime.count() % 7'000'000 != 0; };
  edit.move = [](const ScanPose& pose) {
    FixedPose2 moved = pose.world_T_robot;
    moved.y += 100'000;
    return moved;
  };
  edit.map_T_world = FixedPose2::Nearest({{1, 2}, 0.3});
  return edit;
}

TEST(FoldedLayerTest, WhatComesMeanwhileIsFoldedAsIfItHadBeenThere) {
  ScanArchive archive;
  AddScans(0, 300, archive);
  FoldedLayer layer({1, 1}, AnyEdit(), archive, {});
  AddScans(300, 400, archive);
  ASSERT_TRUE(layer.Fold().ok());
  layer.Append(archive);
  layer.Append(archive);  // nothing new
  ASSERT_TRUE(layer.Fold().ok());
  AddScans(400, 403, archive);
  Shorten(archive, archive.bytes() / 2, {});  // the present layer goes on
  layer.Append(archive);
  ASSERT_TRUE(layer.Fold().ok());

  ScanArchive all;
  AddScans(0, 403, all);
  const ScanArchive edited = AnyEdit().Apply(all);
  EXPECT_EQ(layer.scans_added(), 403);
  EXPECT_EQ(layer.archive().num_scans(), edited.num_scans());
  EXPECT_LT(edited.num_scans(), 403);
  EXPECT_TRUE(DifferentTiles(layer.Tiles(), *FoldArchive(edited, {})).empty());
  EXPECT_TRUE(DifferentTiles(layer.Tiles(), *FoldArchive(layer.archive(), {})).empty());
}

TEST(FoldedLayerTest, ScansThatWentToTheBaseMeanwhileAreMissed) {
  ScanArchive archive;
  AddScans(0, 300, archive);
  const FoldedLayer layer({1, 1}, AnyEdit(), archive, {});
  AddScans(300, 1500, archive);
  EXPECT_TRUE(layer.CanAppend(archive));
  Shorten(archive, archive.bytes() / 10, {});
  EXPECT_FALSE(layer.CanAppend(archive));
}

// A robot that goes far, so that what it saw first is not needed while it is folded.
TEST(FoldedLayerTest, ALayerThatDoesNotFitIntoMemoryIsFoldedToTheSameBytes) {
  ScanArchive archive;
  for (int k = 0; k < 3000; ++k) {
    auto scan = std::make_shared<PosedScan>(*ScanAt(k));
    scan->world_T_robot = FixedPose2::Nearest({{0.05 * (k < 2000 ? k : 4000 - k), 0}, 0});
    archive.Add(scan, {});
  }
  constexpr size_t kMaxTiles = 40;
  const TemporaryDirectory folder;
  const auto memory = std::make_shared<TileMemory>(kMaxTiles);
  const auto spill = SpillFile::Make(folder.path(), memory);
  ASSERT_TRUE(spill.ok()) << spill.status();
  FoldedLayer layer({1, 1}, {}, archive, {}, *spill);
  ASSERT_TRUE(layer.Fold().ok());
  const TileTree tiles = layer.Tiles();
  EXPECT_GT(tiles.size(), 5 * kMaxTiles);
  EXPECT_LE(memory->num_tiles(), kMaxTiles);
  EXPECT_TRUE(DifferentTiles(tiles, *FoldArchive(archive, {})).empty());
  EXPECT_TRUE(
      std::filesystem::is_empty(folder.path()));  // nothing is left, even of a killed process
}

}  // namespace splinemap::folded_layer_test
