#include "lib/store/map_file.h"

#include <SQLiteCpp/SQLiteCpp.h>
#include <gtest/gtest.h>
#include <sys/wait.h>
#include <unistd.h>

#include <csignal>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <map>
#include <random>

#include "lib/base/status.h"
#include "lib/map/tile_update.h"
#include "tests/support/random_map.h"
#include "tests/support/temporary_directory.h"

namespace splinemap {
namespace {

using Content = std::map<std::pair<int, int>, std::pair<Tile, uint64_t>>;

Content ContentOf(const TileTree& tree) {
  Content content;
  tree.ForEach([&](TileKey key, const TileTree::Entry& entry) {
    content[{key.tx, key.ty}] = {*entry.tile, entry.revision};
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

  static void ExpectEqual(const MapSnapshot& a, const MapSnapshot& b) {
    EXPECT_EQ(a.options, b.options);
    EXPECT_EQ(a.controls, b.controls);
    EXPECT_EQ(a.own_layer, b.own_layer);
    EXPECT_EQ(ContentOf(a.merged), ContentOf(b.merged));
    ASSERT_EQ(a.layers.size(), b.layers.size());
    for (size_t k = 0; k < a.layers.size(); ++k) {
      EXPECT_EQ(a.layers[k].id, b.layers[k].id);
      EXPECT_EQ(a.layers[k].epoch, b.layers[k].epoch);
      EXPECT_EQ(a.layers[k].revision, b.layers[k].revision);
      EXPECT_EQ(ContentOf(a.layers[k].tiles), ContentOf(b.layers[k].tiles));
    }
  }

  TemporaryDirectory directory_;
  std::string path_ = directory_.File("map.splinemap");
  Map map_{{0.1, {-2560, 5120}}};
};

TEST_F(MapFileTest, OfALayerThatBeganAnewNothingOldIsLeft) {
  Layer& layer = map_.AddLayer({"robot", 1}, {1, 7});
  Commit(map_.AddLayer({"other", 2}, {1, 8}), 50);
  Commit(layer, 100);
  auto file = MapFile::Open(path_);
  ASSERT_TRUE(file->Save(*map_.Snapshot()).ok());
  layer.BeginEmptyLife({2, 9});
  ASSERT_TRUE(file->Save(*map_.Snapshot()).ok());
  ExpectEqual(*ReadMapFile(path_)->map, *map_.Snapshot());
  EXPECT_EQ(ReadMapFile(path_)->map->layers[0].tiles.size(), 0u);
  layer.BeginCommit();
  layer.EditTile({1000, 7}).control_points.fill(-5);
  ASSERT_TRUE(file->Save(*map_.Snapshot()).ok());
  ExpectEqual(*ReadMapFile(path_)->map, *map_.Snapshot());
}

TEST_F(MapFileTest, LoadsWhatWasSaved) {
  std::mt19937_64 random(1);
  Layer& a = map_.AddLayer({"robot a", 0xffffffffffffffffU}, {3, 0x8000000000000001U});
  map_.AddLayer({"robot b", 2}, {1, 7}).BeginCommit();
  a.BeginCommit();
  for (int k = 0; k < 50; ++k)
    a.EditTile(RandomKey(random, 100000)) = RandomTile(random, map_.options().limits);
  {
    auto file = MapFile::Open(path_);
    ASSERT_TRUE(file.ok()) << file.status();
    EXPECT_TRUE(*file->IsEmpty());
    EXPECT_TRUE(absl::IsNotFound(file->Load().status()));
    ASSERT_TRUE(file->Save(*map_.Snapshot()).ok());
  }
  const auto loaded = ReadMapFile(path_);
  ASSERT_TRUE(loaded.ok()) << loaded.status();
  EXPECT_TRUE(loaded->damages.empty());
  ExpectEqual(*loaded->map, *map_.Snapshot());
}

TEST_F(MapFileTest, IsOneFileWhenClosed) {
  map_.AddLayer({"robot", 1}, {1, 1});
  {
    auto file = MapFile::Open(path_);
    ASSERT_TRUE(file->Save(*map_.Snapshot()).ok());
    EXPECT_TRUE(std::filesystem::exists(path_ + "-wal"));
  }
  const std::filesystem::directory_iterator begin(directory_.path());
  EXPECT_EQ(std::distance(begin, {}), 1);
}

TEST_F(MapFileTest, SavesOfChangesAddUpToTheMap) {
  std::mt19937_64 random(2);
  Layer& layer = map_.AddLayer({"robot", 1}, {1, 1});
  auto file = MapFile::Open(path_);
  for (int n = 0; n < 30; ++n) {
    layer.BeginCommit();
    layer.EditTile(RandomKey(random, 4)) = RandomTile(random, map_.options().limits);
    if (n % 3 == 0) {
      ASSERT_TRUE(file->Save(*map_.Snapshot()).ok());
      ExpectEqual(*ReadMapFile(path_)->map, *map_.Snapshot());
    }
  }
}

TEST_F(MapFileTest, ASecondLifeGoesOnSaving) {
  Commit(map_.AddLayer({"robot", 1}, {1, 1}), 5);
  ASSERT_TRUE(MapFile::Open(path_)->Save(*map_.Snapshot()).ok());
  auto file = MapFile::Open(path_);
  const auto loaded = file->Load();
  Map next(loaded->map->options);
  Layer& layer = next.ContinueLayer(loaded->map->layers[0], {2, 2});
  layer.BeginCommit();
  layer.EditTile({9, 9}).control_points[0] = 3;
  ASSERT_TRUE(file->Save(*next.Snapshot()).ok());
  ExpectEqual(*ReadMapFile(path_)->map, *next.Snapshot());
}

TEST_F(MapFileTest, ALayerThatBeganAnewAndGrewLargerLeavesNothingOld) {
  Layer& layer = map_.AddLayer({"robot", 1}, {1, 7});
  Commit(layer, 100);
  auto file = MapFile::Open(path_);
  ASSERT_TRUE(file->Save(*map_.Snapshot()).ok());
  layer.BeginEmptyLife({2, 8});
  layer.BeginCommit();
  for (int k = 0; k < 20; ++k) layer.EditTile({k, 50}).control_points[0] = 3;
  ASSERT_TRUE(file->Save(*map_.Snapshot()).ok());
  const auto loaded = ReadMapFile(path_);
  EXPECT_TRUE(loaded->damages.empty());
  ExpectEqual(*loaded->map, *map_.Snapshot());
}

TEST_F(MapFileTest, ALayerThatIsGoneIsGoneFromTheFileAndTheOthersStay) {
  Layer& layer = map_.AddLayer({"robot", 1}, {1, 7});
  Commit(layer, 100);
  Commit(map_.AddLayer({"other", 2}, {1, 8}), 50);
  auto file = MapFile::Open(path_);
  ASSERT_TRUE(file->Save(*map_.Snapshot()).ok());
  Commit(layer, 101);
  MapSnapshot without = *map_.Snapshot();
  without.layers.pop_back();
  without.merged = without.layers[0].tiles;
  ASSERT_TRUE(file->Save(without).ok());
  const auto loaded = ReadMapFile(path_);
  EXPECT_TRUE(loaded->damages.empty());
  ExpectEqual(*loaded->map, without);
}

TEST_F(MapFileTest, DecisionsAboutLayersAndWhoseFileItIsAreKept) {
  const LayerId id{"robot", 1};
  Commit(map_.AddLayer(id, {1, 7}), 100);
  Commit(map_.AddLayer({"other", 2}, {1, 8}), 50);
  map_.SetOwnLayer(id);
  LayerControls controls;
  LayerControl control = controls.Next(id, 77);
  control.shift = {-40, 33};
  controls.Take(id, control);
  control = controls.Next({"other", 2}, 78);
  control.yields = true;
  controls.Take({"other", 2}, control);
  controls.Take({"gone", 3}, controls.Removal({"gone", 3}, 12, 79));
  map_.SetControls(controls);
  ASSERT_TRUE(MapFile::Open(path_)->Save(*map_.Snapshot()).ok());
  const auto loaded = ReadMapFile(path_);
  ExpectEqual(*loaded->map, *map_.Snapshot());
  const Tile* shifted = loaded->map->merged.Find({-4, 2});
  ASSERT_NE(shifted, nullptr);
  EXPECT_EQ(shifted->control_points[IndexInTile(0, 0)], 0);
  EXPECT_EQ(shifted->control_points[IndexInTile(0, 1)], 100);
  EXPECT_EQ(loaded->map->controls.Of({"gone", 3}).removed_up_to, (uint64_t{1} << 20) - 1);
}

// A process is killed while it saves; the file holds one whole save, whichever.
TEST_F(MapFileTest, AKilledSaverLeavesNoMixture) {
  for (int round = 0; round < 5; ++round) {
    const pid_t child = fork();
    ASSERT_GE(child, 0);
    if (child == 0) {
      auto file = MapFile::Open(path_);
      Layer& layer = map_.AddLayer({"robot", 1}, {1, 1});
      for (ControlPoint value = 1;; value = static_cast<ControlPoint>(value % 1000 + 1)) {
        layer.BeginCommit();
        for (int k = 0; k < 40; ++k) layer.EditTile({k, 0}).control_points.fill(value);
        if (!file->Save(*map_.Snapshot()).ok()) _exit(1);
      }
    }
    while (true) {  // until a first save is there, then a little longer
      const auto file = ReadMapFile(path_);
      if (file.ok() && file->map->merged.size() > 0) break;
      usleep(1000);
    }
    usleep(1000 * (3 + 7 * round));
    kill(child, SIGKILL);
    int status = 0;
    waitpid(child, &status, 0);
    ASSERT_TRUE(WIFSIGNALED(status)) << "the saver failed before it was killed";

    const auto file = MapFile::Open(path_);
    ASSERT_TRUE(file.ok()) << file.status();
    const auto loaded = ReadMapFile(path_);
    ASSERT_TRUE(loaded.ok()) << loaded.status();
    EXPECT_TRUE(loaded->damages.empty());
    ASSERT_EQ(loaded->map->merged.size(), 40u);
    const ControlPoint value = loaded->map->merged.Find({0, 0})->control_points[0];
    loaded->map->merged.ForEach([&](TileKey, const TileTree::Entry& entry) {
      for (const ControlPoint c : entry.tile->control_points) ASSERT_EQ(c, value);
    });
    std::filesystem::remove(path_);
    std::filesystem::remove(path_ + "-wal");
    std::filesystem::remove(path_ + "-shm");
  }
}

TEST_F(MapFileTest, AFailedSaveLeavesTheFileAndIsMadeUpForLater) {
  Layer& layer = map_.AddLayer({"robot", 1}, {1, 1});
  Commit(layer, 5);
  auto file = MapFile::Open(path_);
  ASSERT_TRUE(file->Save(*map_.Snapshot()).ok());
  const auto before = ReadMapFile(path_);
  Commit(layer, 6);
  {
    SQLite::Database other(path_, SQLite::OPEN_READWRITE);
    other.exec(
        "CREATE TRIGGER full BEFORE INSERT ON tile BEGIN SELECT RAISE(FAIL, 'disk full'); END");
    const absl::Status status = file->Save(*map_.Snapshot());
    EXPECT_NE(std::string(status.message()).find("disk full"), std::string::npos) << status;
    other.exec("DROP TRIGGER full");
  }
  ExpectEqual(*ReadMapFile(path_)->map, *before->map);
  ASSERT_TRUE(file->Save(*map_.Snapshot()).ok());
  ExpectEqual(*ReadMapFile(path_)->map, *map_.Snapshot());
}

TEST_F(MapFileTest, ADamagedTileIsReportedAndTheRestIsLoaded) {
  Commit(map_.AddLayer({"robot", 1}, {1, 1}), 5);
  ASSERT_TRUE(MapFile::Open(path_)->Save(*map_.Snapshot()).ok());
  {
    SQLite::Database database(path_, SQLite::OPEN_READWRITE);
    database.exec("UPDATE tile SET checksum = checksum + 1 WHERE tx = 2");
    database.exec("UPDATE tile SET content = x'00' WHERE tx = 3");
    database.exec("UPDATE tile SET revision = -1 WHERE tx = 1");
    // A tile whose checksum is right and whose key no tree can hold.
    const TileUpdate far = MakeTileUpdate({2147483647, 0}, {}, 1);
    SQLite::Statement insert(database, "INSERT INTO tile VALUES (1, ?, 0, 1, ?, ?)");
    insert.bind(1, far.key.tx);
    insert.bind(2, static_cast<int64_t>(far.checksum));
    insert.bind(3, far.content.data(), static_cast<int>(far.content.size()));
    insert.exec();
  }
  const auto loaded = ReadMapFile(path_);
  ASSERT_TRUE(loaded.ok()) << loaded.status();
  EXPECT_EQ(loaded->damages.size(), 5u);  // and the count of the tiles
  EXPECT_EQ(loaded->map->merged.size(), 4u);
}

TEST_F(MapFileTest, WhatIsMissingIsReported) {
  for (const char* statement :
       {"DELETE FROM tile WHERE tx = 1", "UPDATE tile SET layer = 7 WHERE layer = 2",
        "UPDATE tile SET revision = 1 WHERE tx = 0", "DELETE FROM layer WHERE id = 2"}) {
    std::filesystem::remove(path_);
    Map map({0.1, {-2560, 5120}});
    for (const uint64_t origin : {1, 2}) {
      Layer& layer = map.AddLayer({"robot", origin}, {1, 1});
      Commit(layer, 3);
      Commit(layer, 6);
    }
    ASSERT_TRUE(MapFile::Open(path_)->Save(*map.Snapshot()).ok());
    EXPECT_TRUE(ReadMapFile(path_)->damages.empty());
    SQLite::Database(path_, SQLite::OPEN_READWRITE).exec(statement);
    const auto loaded = ReadMapFile(path_);
    ASSERT_TRUE(loaded.ok()) << loaded.status();
    EXPECT_FALSE(loaded->damages.empty()) << statement;
  }
}

TEST_F(MapFileTest, TheNextSaveMendsADamagedMap) {
  Commit(map_.AddLayer({"robot", 1}, {1, 1}), 5);
  ASSERT_TRUE(MapFile::Open(path_)->Save(*map_.Snapshot()).ok());
  SQLite::Database(path_, SQLite::OPEN_READWRITE)
      .exec("UPDATE tile SET content = x'00' WHERE tx = 3");
  auto file = MapFile::Open(path_);
  const auto loaded = file->Load();
  ASSERT_EQ(loaded->damages.size(), 1u);
  ASSERT_TRUE(file->Save(*loaded->map).ok());
  const auto again = ReadMapFile(path_);
  EXPECT_TRUE(again->damages.empty());
  ExpectEqual(*again->map, *loaded->map);
}

class DamagedMapFileTest : public MapFileTest {
 protected:
  // A map of two layers, saved in several steps.
  DamagedMapFileTest() {
    std::mt19937_64 random(3);
    Layer& a = map_.AddLayer({"robot a", 1}, {1, 1});
    Layer& b = map_.AddLayer({"robot b", 2}, {1, 1});
    auto file = MapFile::Open(path_);
    for (int n = 0; n < 5; ++n) {
      for (Layer* layer : {&a, &b}) {
        layer->BeginCommit();
        for (int k = 0; k < 5; ++k) {
          layer->EditTile(RandomKey(random, 6)) = RandomTile(random, map_.options().limits);
        }
      }
      EXPECT_TRUE(file->Save(*map_.Snapshot()).ok());
    }
    EXPECT_TRUE(file->Close().ok());
    std::ifstream in(path_, std::ios::binary);
    bytes_.assign(std::istreambuf_iterator<char>(in), {});
  }

  // Loads a file of these bytes: refused, or damages are listed, or the map is whole.
  void ExpectNothingSilentlyWrong(const std::string& bytes, const std::string& what) {
    std::ofstream(path_, std::ios::binary) << bytes;
    const auto loaded = ReadMapFile(path_);
    if (!loaded.ok()) {
      ++refused_;
      EXPECT_FALSE(ErrorText(loaded.status()).empty()) << what;
    } else if (!loaded->damages.empty()) {
      ++damaged_;
    } else {
      ++whole_;
      SCOPED_TRACE(what);
      ExpectEqual(*loaded->map, *map_.Snapshot());
    }
  }

  std::string bytes_;
  int refused_ = 0;
  int damaged_ = 0;
  int whole_ = 0;
};

TEST_F(DamagedMapFileTest, NoFlippedBitGoesUnnoticed) {
  std::mt19937_64 random(1);
  for (int round = 0; round < 500; ++round) {
    std::string bytes = bytes_;
    const size_t place = random() % bytes.size();
    const size_t bit = random() % 8;
    bytes[place] = static_cast<char>(bytes[place] ^ (1 << bit));
    ExpectNothingSilentlyWrong(bytes, fmt::format("bit {} of byte {}", bit, place));
  }
  EXPECT_GT(damaged_, 50);
  EXPECT_GT(whole_, 10);  // places that are not in use
}

TEST_F(DamagedMapFileTest, NoDamagedPageGoesUnnoticed) {
  std::mt19937_64 random(2);
  constexpr size_t kPage = 4096;
  for (size_t page = 0; page < bytes_.size() / kPage; ++page) {
    for (const size_t length : {size_t{8}, size_t{200}, kPage}) {
      std::string bytes = bytes_;
      for (size_t k = 0; k < length; ++k) bytes[page * kPage + k] = static_cast<char>(random());
      ExpectNothingSilentlyWrong(bytes, fmt::format("{} bytes of page {}", length, page));
      ExpectNothingSilentlyWrong(bytes_.substr(0, page * kPage + length % kPage),
                                 fmt::format("cut within page {}", page));
    }
  }
  EXPECT_GT(refused_, 10);
}

TEST_F(DamagedMapFileTest, AForeignLogBesideTheMapIsNotMixedIn) {
  std::ofstream(path_ + "-wal", std::ios::binary) << std::string(10'000, 'x');
  ExpectNothingSilentlyWrong(bytes_, "text as -wal");
  EXPECT_EQ(whole_, 1);
  // What another map's daemon left when it was killed, the last save in it.
  const std::string other_path = directory_.File("other");
  Map other(map_.options());
  Layer& layer = other.AddLayer({"robot a", 1}, {1, 1});
  auto file = MapFile::Open(other_path);
  for (ControlPoint value = 3; value < 6; ++value) {
    Commit(layer, value);
    ASSERT_TRUE(file->Save(*other.Snapshot()).ok());
  }
  std::filesystem::copy_file(other_path + "-wal", path_ + "-wal",
                             std::filesystem::copy_options::overwrite_existing);
  const auto loaded = ReadMapFile(path_);
  if (loaded.ok() && loaded->damages.empty()) ExpectEqual(*loaded->map, *other.Snapshot());
}

TEST_F(MapFileTest, ASecondWriterIsRefused) {
  auto first = MapFile::Open(path_);
  ASSERT_TRUE(first.ok());
  const absl::Status status = MapFile::Open(path_).status();
  EXPECT_TRUE(absl::IsFailedPrecondition(status));
  EXPECT_NE(std::string(status.message()).find("in use"), std::string::npos) << status;
  EXPECT_TRUE(first->Close().ok());
  first = absl::UnknownError("gone");
  EXPECT_TRUE(MapFile::Open(path_).ok());
}

TEST_F(MapFileTest, AFileThatIsDeletedOrReplacedIsNoticed) {
  map_.AddLayer({"robot", 1}, {1, 1});
  auto file = MapFile::Open(path_);
  ASSERT_TRUE(file->Save(*map_.Snapshot()).ok());
  std::filesystem::remove(path_);
  EXPECT_TRUE(absl::IsFailedPrecondition(file->Save(*map_.Snapshot())));
  std::ofstream(path_) << "another";
  EXPECT_TRUE(absl::IsFailedPrecondition(file->Save(*map_.Snapshot())));
}

TEST_F(MapFileTest, ACopyOfTheFileInUseHasTheLastSave) {
  Commit(map_.AddLayer({"robot", 1}, {1, 1}), 5);
  auto file = MapFile::Open(path_);
  ASSERT_TRUE(file->Save(*map_.Snapshot()).ok());
  const std::string copy = directory_.File("copy");
  std::filesystem::copy_file(path_, copy);
  ExpectEqual(*ReadMapFile(copy)->map, *map_.Snapshot());
}

TEST_F(MapFileTest, ClosedWhileSomeoneReadsTheOneFileHasEverything) {
  Commit(map_.AddLayer({"robot", 1}, {1, 1}), 5);
  auto file = MapFile::Open(path_);
  ASSERT_TRUE(file->Save(*map_.Snapshot()).ok());
  auto reader = MapFile::OpenReadOnly(path_);
  ASSERT_TRUE(reader->Load().ok());
  EXPECT_TRUE(file->Close().ok());
  EXPECT_TRUE(absl::IsFailedPrecondition(file->Close()));
  const std::string copy = directory_.File("copy");
  std::filesystem::copy_file(path_, copy);
  ExpectEqual(*ReadMapFile(copy)->map, *map_.Snapshot());
}

TEST_F(MapFileTest, ANameMayBeAnyBytes) {
  map_.AddLayer({"B\xfcro \x01", 1}, {1, 1});
  ASSERT_TRUE(MapFile::Open(path_)->Save(*map_.Snapshot()).ok());
  ExpectEqual(*ReadMapFile(path_)->map, *map_.Snapshot());
}

TEST_F(MapFileTest, ADamagedMapRecordIsRefused) {
  map_.AddLayer({"robot", 1}, {1, 1});
  ASSERT_TRUE(MapFile::Open(path_)->Save(*map_.Snapshot()).ok());
  SQLite::Database(path_, SQLite::OPEN_READWRITE).exec("UPDATE map SET record = x''");
  EXPECT_TRUE(absl::IsDataLoss(ReadMapFile(path_).status()));
}

TEST_F(MapFileTest, RefusesWhatIsNoMapInWords) {
  EXPECT_TRUE(absl::IsNotFound(ReadMapFile(path_).status()));
  std::ofstream(path_) << std::string(5000, 'x');
  EXPECT_TRUE(absl::IsInvalidArgument(ReadMapFile(path_).status())) << ReadMapFile(path_).status();
  EXPECT_TRUE(absl::IsInvalidArgument(MapFile::Open(path_).status()));

  const std::string foreign = directory_.File("foreign");
  SQLite::Database(foreign, SQLite::OPEN_READWRITE | SQLite::OPEN_CREATE)
      .exec("CREATE TABLE t (x)");
  EXPECT_NE(std::string(MapFile::Open(foreign).status().message()).find("another program"),
            std::string::npos);
  EXPECT_FALSE(MapFile::Open(directory_.File("no/such/folder")).ok());
}

TEST_F(MapFileTest, TablesThatRunSomethingAreRefused) {
  for (const char* statement : {"CREATE TRIGGER t AFTER INSERT ON tile BEGIN DELETE FROM tile; END",
                                "CREATE VIEW v AS WITH RECURSIVE r (x) AS (SELECT 1 UNION ALL "
                                "SELECT x FROM r) SELECT * FROM r",
                                "ALTER TABLE layer ADD COLUMN more ANY"}) {
    std::filesystem::remove(path_);
    ASSERT_TRUE(MapFile::Open(path_)->Save(*map_.Snapshot()).ok());
    SQLite::Database(path_, SQLite::OPEN_READWRITE).exec(statement);
    EXPECT_TRUE(absl::IsInvalidArgument(ReadMapFile(path_).status())) << statement;
    EXPECT_TRUE(absl::IsInvalidArgument(MapFile::Open(path_).status())) << statement;
  }
}

TEST_F(MapFileTest, RefusesAFolder) {
  const absl::Status status = ReadMapFile(directory_.path()).status();
  EXPECT_NE(ErrorText(status).find("it is a folder"), std::string::npos) << status;
  EXPECT_FALSE(MapFile::Open(directory_.path()).ok());
}

TEST_F(MapFileTest, RefusesAnotherSchema) {
  map_.AddLayer({"robot", 1}, {1, 1});
  ASSERT_TRUE(MapFile::Open(path_)->Save(*map_.Snapshot()).ok());
  SQLite::Database(path_, SQLite::OPEN_READWRITE).exec("PRAGMA user_version = 3");
  EXPECT_NE(ErrorText(MapFile::Open(path_).status()).find("a newer splinemap"), std::string::npos);
  SQLite::Database(path_, SQLite::OPEN_READWRITE).exec("PRAGMA user_version = 1");
  EXPECT_NE(ErrorText(ReadMapFile(path_).status()).find("an older splinemap"), std::string::npos);
}

}  // namespace
}  // namespace splinemap
