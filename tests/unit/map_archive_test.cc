#include <SQLiteCpp/SQLiteCpp.h>
#include <gtest/gtest.h>
#include <sys/wait.h>
#include <unistd.h>

#include <csignal>
#include <filesystem>
#include <random>

#include "splinemap/file.h"
#include "splinemap/scan_archive.h"
#include "tests/support/map_file_fixture.h"
#include "tests/support/map_writer.h"
#include "tests/support/random_map.h"
#include "tests/support/shared_data.h"

namespace splinemap::map_archive_test {

std::shared_ptr<const PosedScan> ScanAt(int64_t utime) {
  auto scan = std::make_shared<PosedScan>();
  scan->utime = Utime(utime);
  scan->robot_T_sensor.resize(1);
  for (int k = 0; k < 90; ++k) {
    scan->beams.push_back({static_cast<float>(1 + 0.01 * static_cast<double>((utime + k) % 97)),
                           0.07F * static_cast<float>(k), Utime(0), true,
                           static_cast<uint16_t>(k)});
  }
  return scan;
}

// Utime and x of all scans of the first layer.
std::vector<std::pair<int64_t, int64_t>> ScansIn(const LayerSet& set) {
  std::vector<std::pair<int64_t, int64_t>> scans;
  set.layers.front().archive->ForEach([&](const PosedScan& scan, const BeamModelOptions&) {
    scans.emplace_back(scan.utime.count(), scan.world_T_robot.x);
  });
  return scans;
}

class MapFileArchiveTest : public MapFileTest {
 protected:
  void AddScans(int count) {
    for (int k = 0; k < count; ++k) archive_.Add(ScanAt(10 * archive_.scans_added()), {});
  }
  LayerSet Set() {
    LayerSet set = map_.Layers();
    set.layers.front().archive = std::make_shared<ScanArchive>(archive_);
    return set;
  }
  ScanArchive archive_;
};

TEST_F(MapFileArchiveTest, HasTheScansAndTheBaseOfEachSaveWhateverChanged) {
  Layer& layer = map_.AddLayer({"robot", 1}, {1, 7});
  Commit(layer, 10);
  std::mt19937_64 random(3);
  auto file = MapFile::Open(path_);
  for (int round = 0; round < 40; ++round) {
    switch (random() % 6) {
      case 0:
        if (archive_.TakeOldest() != nullptr) {
          TileTreeEditor base(archive_.base.tiles);
          base.Edit({round, 0}, 0).Edit() = RandomTile(random, map_.options().limits);
          archive_.base = {base.Freeze(), FixedPose2{round, 0, 5}, round, Utime(round)};
        }
        break;
      case 1:
        archive_ = archive_.Moved([&](const ScanPose& pose) {
          FixedPose2 moved = pose.world_T_robot;
          if (pose.utime.count() % 700 < 200) moved.x += round;
          return moved;
        });
        break;
      case 2:
        archive_ = archive_.Filtered(
            [&](const ScanPose& pose) { return pose.utime.count() % 1900 != 10 * round; });
        break;
      case 3:
        layer.ReplaceTiles({2 + static_cast<uint64_t>(round), 7}, layer.Snapshot().tiles);
        break;
      case 4:
        file = absl::UnknownError("closed");
        file = MapFile::Open(path_);  // another process goes on
        ASSERT_TRUE(file.ok()) << file.status();
        file->Load().IgnoreError();
        break;
      default:
        AddScans(static_cast<int>(random() % 400));
    }
    archive_.map_T_world = FixedPose2{round, -round, round};
    const LayerSet set = Set();
    ASSERT_TRUE(file->Save(set)->empty());
    const auto loaded = ReadMapFile(path_);
    ASSERT_TRUE(loaded->corruption.empty()) << loaded->corruption.front();
    ASSERT_EQ(ScansIn(loaded->set), ScansIn(set)) << "round " << round;
    const ScanArchive& read = *loaded->set.layers.front().archive;
    EXPECT_EQ(read.map_T_world, archive_.map_T_world);
    EXPECT_EQ(read.base.map_T_world, archive_.base.map_T_world);
    EXPECT_EQ(read.base.scans, archive_.base.scans);
    EXPECT_EQ(read.base.newest, archive_.base.newest);
    EXPECT_EQ(ContentOf(read.base.tiles), ContentOf(archive_.base.tiles));
  }
}

TEST_F(MapFileArchiveTest, LayersThatBeginWithoutScansKeepTheirsApart) {
  map_.AddLayer({"robot", 1}, {1, 7});
  map_.AddLayer({"other", 2}, {1, 8});
  ScanArchive other;
  const auto set = [&] {
    LayerSet layers = Set();
    layers.layers[1].archive = std::make_shared<ScanArchive>(other);
    return layers;
  };
  auto file = MapFile::Open(path_);
  ASSERT_TRUE(file->Save(set())->empty());
  AddScans(5);
  ASSERT_TRUE(file->Save(set())->empty());
  other.Add(ScanAt(12'340), {});
  ASSERT_TRUE(file->Save(set())->empty());
  const auto loaded = ReadMapFile(path_);
  EXPECT_TRUE(loaded->corruption.empty());
  EXPECT_EQ(ScansIn(loaded->set).size(), 5u);
  EXPECT_EQ(loaded->set.layers[1].archive->num_scans(), 1);
}

TEST_F(MapFileArchiveTest, WhatIsSavedAlreadyIsNotWrittenAgain) {
  map_.AddLayer({"robot", 1}, {1, 7});
  AddScans(2000);
  auto file = MapFile::Open(path_);
  ASSERT_TRUE(file->Save(Set()).ok());
  const auto size = [&] { return std::filesystem::file_size(path_ + "-wal"); };
  const auto before = size();
  AddScans(1);
  ASSERT_TRUE(file->Save(Set()).ok());
  EXPECT_LT(size(), before + 200'000);
  SQLite::Database database(path_);
  EXPECT_EQ(database.execAndGet("SELECT count(*) FROM scan_beams").getInt(),
            database.execAndGet("SELECT count(*) FROM scan_poses").getInt());
}

// All tiles say how many scans there were, those of the base how many it has.
TEST_F(MapFileArchiveTest, AKilledSaverLeavesTilesAndScansOfOneSave) {
  for (int round = 0; round < 8; ++round) {
    const pid_t child = fork();
    ASSERT_GE(child, 0);
    if (child == 0) {
      auto file = MapFile::Open(path_);
      Layer& layer = map_.AddLayer({"robot", 1}, {1, 1});
      while (true) {
        AddScans(37);
        if (archive_.num_scans() > 600) {
          archive_.base.scans += archive_.TakeOldest()->num_scans;
          TileTreeEditor base;
          for (int k = 0; k < 20; ++k) {
            base.Edit({k, 0}, 1).Edit().control_points.fill(
                static_cast<ControlPoint>(archive_.base.scans % 5'000));
          }
          archive_.base.tiles = base.Freeze();
        }
        layer.BeginCommit();
        for (int k = 0; k < 20; ++k) {
          layer.EditTile({k, 0}).control_points.fill(
              static_cast<ControlPoint>(archive_.scans_added() % 5'000));
        }
        if (!file->Save(Set()).ok()) _exit(1);
      }
    }
    const auto is_saved = [&] {
      const auto map = ReadMapFile(path_);
      return map.ok() && !map->set.layers.empty();
    };
    while (!is_saved()) usleep(1000);
    usleep(1000 * (20 + 29 * round));
    kill(child, SIGKILL);
    int status = 0;
    waitpid(child, &status, 0);
    ASSERT_TRUE(WIFSIGNALED(status)) << "the saver failed before it was killed";

    const auto loaded = ReadMapFile(path_);
    ASSERT_TRUE(loaded.ok()) << loaded.status();
    ASSERT_TRUE(loaded->corruption.empty()) << loaded->corruption.front();
    const LayerSnapshot& layer = loaded->set.layers.front();
    const int64_t scans = layer.archive->base.scans + layer.archive->num_scans();
    layer.tiles.ForEach([&](TileKey, const TileTree::Entry& entry) {
      ASSERT_EQ(entry.tile->Get()->control_points[7], scans % 5'000);
    });
    layer.archive->base.tiles.ForEach([&](TileKey, const TileTree::Entry& entry) {
      ASSERT_EQ(entry.tile->Get()->control_points[7], layer.archive->base.scans % 5'000);
    });
    EXPECT_EQ(layer.tiles.size(), 20u);
    MapFile::Remove(path_);
  }
}

TEST_F(MapFileArchiveTest, AFileOfTheSchemaBeforeHasTheLayerAsItsBase) {
  std::filesystem::copy_file(TestData("map_of_schema_2"), path_);
  const LayerSnapshot layer = ReadMapFile(path_)->set.layers.front();
  ASSERT_NE(layer.archive, nullptr);
  EXPECT_EQ(layer.archive->num_scans(), 0);
  EXPECT_EQ(ContentOf(layer.archive->base.tiles), ContentOf(layer.tiles));
}

TEST_F(MapFileArchiveTest, ADamagedRowIsReportedAndTheOthersAreRead) {
  map_.AddLayer({"robot", 1}, {1, 7});
  AddScans(1000);
  ASSERT_TRUE(MapFile::Open(path_)->Save(Set()).ok());
  SQLite::Database(path_, SQLite::OPEN_READWRITE)
      .exec("UPDATE scan_beams SET content = zeroblob(100) WHERE block = 2");
  const auto loaded = ReadMapFile(path_);
  ASSERT_TRUE(loaded.ok());
  ASSERT_FALSE(loaded->corruption.empty());
  EXPECT_NE(loaded->corruption.front().find("of the 1000 scans"), std::string::npos)
      << loaded->corruption.front();
  const size_t read = ScansIn(loaded->set).size();
  EXPECT_GT(read, 500u);
  EXPECT_LT(read, 1000u);
}

}  // namespace splinemap::map_archive_test
