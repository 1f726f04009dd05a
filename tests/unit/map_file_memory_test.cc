// Map files of which not all is in memory.

#include <SQLiteCpp/SQLiteCpp.h>
#include <gtest/gtest.h>

#include <filesystem>
#include <memory>
#include <optional>
#include <random>
#include <vector>

#include "lib/mapping/scan_folder.h"
#include "lib/tiles/tile_memory.h"
#include "splinemap/file.h"
#include "tests/support/map_file_fixture.h"

namespace splinemap::map_file_memory_test {

class MapFileMemoryTest : public MapFileTest {
 protected:
  static constexpr size_t kMaxTiles = 8;

  void Open() {
    memory_ = std::make_shared<TileMemory>(kMaxTiles);
    auto opened = MapFile::Open(path_, memory_);
    ASSERT_TRUE(opened.ok()) << opened.status();
    file_.emplace(*std::move(opened));
  }

  // A commit to some tiles out of many.
  void CommitTo(Layer& layer) {
    layer.BeginCommit();
    for (int k = 0; k < 5; ++k) {
      Tile& tile =
          layer.EditTile({static_cast<int>(random_() % 12), static_cast<int>(random_() % 9)});
      tile.control_points[random_() % Tile::kSize] =
          static_cast<ControlPoint>(random_() % 2000 + 1);
    }
  }

  // Opens the file and saves the layer to it after some commits.
  LayerSet Fill(Layer& layer) {
    Open();
    for (int step = 0; step < 50; ++step) CommitTo(layer);
    LayerSet set{.options = map_.options(), .layers = {layer.Snapshot()}};
    EXPECT_TRUE(file_->Save(set)->empty());
    return set;
  }

  int64_t RowsOf(const std::string& path) {
    return SQLite::Database(path).execAndGet("SELECT count(*) FROM tile").getInt64();
  }

  std::mt19937_64 random_{3};
  std::shared_ptr<TileMemory> memory_;
  std::optional<MapFile> file_;
};

TEST_F(MapFileMemoryTest, WhateverIsInMemoryTheMapIsTheSame) {
  Layer plain(LayerId{"robot", 1}, SessionId{1, 1});  // all in memory
  std::optional<Layer> layer(std::in_place, LayerId{"robot", 1}, SessionId{1, 1});
  std::vector<std::pair<LayerSnapshot, Content>> earlier;
  Open();
  for (int step = 0; step < 400; ++step) {
    const std::mt19937_64 as_it_was = random_;
    CommitTo(*layer);
    random_ = as_it_was;
    CommitTo(plain);
    if (step % 3 == 0) {
      const LayerSet set{.options = map_.options(), .layers = {layer->Snapshot()}};
      ASSERT_TRUE(file_->Save(set)->empty());
      EXPECT_LE(memory_->num_tiles(), kMaxTiles);
    }
    if (step % 40 == 7) earlier.emplace_back(layer->Snapshot(), ContentOf(plain.tiles()));
    if (step % 50 == 49) {
      // Who still has them keeps an earlier state.
      for (const auto& [snapshot, content] : earlier) {
        ASSERT_EQ(ContentOf(snapshot.tiles), content);
      }
      earlier.clear();
      ASSERT_TRUE(file_->Save({.options = map_.options(), .layers = {layer->Snapshot()}})->empty());
      layer.reset();
      ASSERT_TRUE(file_->Close().ok());
      file_.reset();
      Open();
      const auto loaded = file_->Load();
      ASSERT_TRUE(loaded.ok() && loaded->corruption.empty());
      EXPECT_EQ(memory_->num_tiles(), 0u);
      layer.emplace(loaded->set.layers.at(0), SessionId{1, 1});
    }
    ASSERT_EQ(ContentOf(layer->tiles()), ContentOf(plain.tiles())) << step;
    EXPECT_EQ(layer->revision(), plain.revision());
  }
}

TEST_F(MapFileMemoryTest, RowsThatNobodyNeedsAreDeletedAlsoAfterACrash) {
  Open();
  Layer layer(LayerId{"robot", 1}, SessionId{1, 1});
  const auto save = [&] {
    ASSERT_TRUE(file_->Save({.options = map_.options(), .layers = {layer.Snapshot()}})->empty());
  };
  for (int step = 0; step < 50; ++step) {
    CommitTo(layer);
    save();
  }
  const auto num_tiles = static_cast<int64_t>(layer.tiles().size());
  EXPECT_GT(RowsOf(path_), num_tiles);  // those that the last save replaced
  EXPECT_LE(RowsOf(path_), num_tiles + 10);
  // The state of a process that was killed.
  const std::string copy = directory_.File("copy.splinemap");
  std::filesystem::copy_file(path_, copy);
  std::filesystem::copy_file(path_ + "-wal", copy + "-wal");
  path_ = copy;
  file_.reset();
  Open();
  const auto loaded = file_->Load();
  ASSERT_TRUE(loaded.ok() && loaded->corruption.empty());
  Layer next(loaded->set.layers.at(0), {2, 2});
  for (int step = 0; step < 3; ++step) {
    ASSERT_TRUE(file_->Save({.options = map_.options(), .layers = {next.Snapshot()}})->empty());
  }
  EXPECT_EQ(RowsOf(path_), num_tiles);
}

TEST_F(MapFileMemoryTest, AFileThatIsDeletedIsWrittenElsewhereWithAllTiles) {
  Layer layer(LayerId{"robot", 1}, SessionId{1, 1});
  const LayerSet set = Fill(layer);
  const Content content = ContentOf(set.layers[0].tiles);
  for (const char* beside : {"", "-wal", "-shm"}) std::filesystem::remove(path_ + beside);
  // Another map takes its name.
  ASSERT_TRUE(MapFile::Open(path_)->Save(map_.Layers()).ok());
  EXPECT_FALSE(file_->Save(set).ok());
  const std::string rescue = directory_.File("rescue.splinemap");
  ASSERT_TRUE(file_->SaveElsewhere(rescue, set)->empty());
  EXPECT_EQ(ContentOf(ReadMapFile(rescue)->set.layers.at(0).tiles), content);
  EXPECT_EQ(ContentOf(layer.tiles()), content);
  CommitTo(layer);
  ASSERT_TRUE(file_->Save({.options = map_.options(), .layers = {layer.Snapshot()}})->empty());
  EXPECT_EQ(ContentOf(ReadMapFile(rescue)->set.layers.at(0).tiles), ContentOf(layer.tiles()));
}

TEST_F(MapFileMemoryTest, NoTileIsTakenForAnother) {
  Layer layer(LayerId{"robot", 1}, SessionId{1, 1});
  const LayerSet set = Fill(layer);
  for (int n = 0; n < 2; ++n) {
    const auto key = std::pair(n, 0);
    ASSERT_NE(set.layers[0].tiles.Find({key.first, key.second}), nullptr);
  }
  ContentOf(set.layers[0].tiles);  // nothing else is in memory than the last ones
  SQLite::Database(path_, SQLite::OPEN_READWRITE)
      .exec(
          "UPDATE tile SET number = -number WHERE ty = 0 AND tx < 2;"
          "UPDATE tile SET number = (SELECT -number FROM tile AS other WHERE other.number < 0 AND "
          "other.tx = 1 - tile.tx) WHERE number < 0 AND tx = 0");
  EXPECT_EQ(set.layers[0].tiles.Find({1, 0})->TryGet(), nullptr);
  EXPECT_FALSE(file_->Save(set)->empty());
}

// A disk that is away for a moment.
TEST_F(MapFileMemoryTest, NoScanWritesOverWhatCannotBeRead) {
  Layer layer(LayerId{"robot", 1}, SessionId{1, 1});
  const LayerSet set = Fill(layer);
  const Content content = ContentOf(set.layers[0].tiles);
  SQLite::Database database(path_, SQLite::OPEN_READWRITE);
  database.exec("UPDATE tile SET checksum = checksum + 1");
  PlacedScan scan;
  PlacedBeam beam;
  beam.origin_world_m = {1, 1};
  beam.direction_world = {1, 0};
  beam.range_m = 3;
  beam.hit = true;
  scan.beams = {beam};
  ScanFolder folder(map_.options());
  folder.Fold(scan, {}, layer);
  database.exec("UPDATE tile SET checksum = checksum - 1");
  for (const auto& [key, tile] : content) {
    EXPECT_EQ(*FindTile(layer.tiles(), {key.first, key.second}), tile.first);
  }
  folder.Fold(scan, {}, layer);
  EXPECT_NE(ContentOf(layer.tiles()), content);
}

TEST_F(MapFileMemoryTest, ASaveToAnotherFileTakesNothingFromTheFirst) {
  Layer layer(LayerId{"robot", 1}, SessionId{1, 1});
  const LayerSet set = Fill(layer);
  const std::string other = directory_.File("other.splinemap");
  ASSERT_TRUE(MapFile::Open(other, memory_)->Save(set)->empty());
  ASSERT_TRUE(file_->Save(set)->empty());
  ASSERT_TRUE(file_->Close().ok());
  for (const std::string& path : {path_, other}) {
    const auto loaded = ReadMapFile(path);
    EXPECT_TRUE(loaded->corruption.empty());
    EXPECT_EQ(ContentOf(loaded->set.layers.at(0).tiles), ContentOf(layer.tiles()));
  }
}

TEST_F(MapFileMemoryTest, ATileThatCannotBeReadIsTold) {
  Layer layer(LayerId{"robot", 1}, SessionId{1, 1});
  const LayerSet set = Fill(layer);
  Content content = ContentOf(set.layers[0].tiles);
  SQLite::Database(path_, SQLite::OPEN_READWRITE)
      .exec("UPDATE tile SET content = x'00' WHERE tx = 3 AND ty = 2");
  for (auto& [key, tile] : content) {
    if (key == std::pair(3, 2)) tile.first = Tile();
  }
  EXPECT_EQ(ContentOf(set.layers[0].tiles), content);
  const auto problems = file_->Save(set);
  ASSERT_TRUE(problems.ok());
  ASSERT_EQ(problems->size(), 1u);
  EXPECT_NE(problems->front().find("tile (3, 2) cannot be read"), std::string::npos)
      << problems->front();
}

}  // namespace splinemap::map_file_memory_test
