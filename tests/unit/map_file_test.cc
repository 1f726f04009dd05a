#include <SQLiteCpp/SQLiteCpp.h>
#include <gtest/gtest.h>
#include <sys/wait.h>
#include <unistd.h>
#include <xxhash.h>

#include <cmath>
#include <csignal>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <random>

#include "lib/base/status.h"
#include "lib/map/placed_tile.h"
#include "lib/store/records.pb.h"
#include "lib/tiles/tile_codec.h"
#include "splinemap/file.h"
#include "tests/support/map_file_fixture.h"
#include "tests/support/map_writer.h"
#include "tests/support/placement.h"
#include "tests/support/random_map.h"
#include "tests/support/shared_data.h"

namespace splinemap::map_file_test {

TEST_F(MapFileTest, OfALayerThatBeganAnewNothingOldIsLeft) {
  Layer& layer = map_.AddLayer({"robot", 1}, {1, 7});
  Commit(map_.AddLayer({"other", 2}, {1, 8}), 50);
  Commit(layer, 100);
  auto file = MapFile::Open(path_);
  ASSERT_TRUE(file->Save(map_.Layers()).ok());
  layer.StartEmptySession({2, 9});
  ASSERT_TRUE(file->Save(map_.Layers()).ok());
  ExpectEqual(ReadMapFile(path_)->set, map_.Layers());
  EXPECT_EQ(ReadMapFile(path_)->set.layers[0].tiles.size(), 0u);
  layer.BeginCommit();
  layer.EditTile({1000, 7}).control_points.fill(-5);
  ASSERT_TRUE(file->Save(map_.Layers()).ok());
  ExpectEqual(ReadMapFile(path_)->set, map_.Layers());
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
    EXPECT_TRUE(absl::IsNotFound(file->Load().status()));
    ASSERT_TRUE(file->Save(map_.Layers()).ok());
  }
  const auto loaded = ReadMapFile(path_);
  ASSERT_TRUE(loaded.ok()) << loaded.status();
  EXPECT_TRUE(loaded->corruption.empty());
  ExpectEqual(loaded->set, map_.Layers());
}

TEST_F(MapFileTest, IsOneFileWhenClosed) {
  map_.AddLayer({"robot", 1}, {1, 1});
  {
    auto file = MapFile::Open(path_);
    ASSERT_TRUE(file->Save(map_.Layers()).ok());
    EXPECT_TRUE(std::filesystem::exists(path_ + "-wal"));
  }
  const std::filesystem::directory_iterator begin(directory_.path());
  EXPECT_EQ(std::distance(begin, {}), 1);
}

TEST_F(MapFileTest, ANewFileHasTheMapAndStandsAlone) {
  std::mt19937_64 random(1);
  Layer& layer = map_.AddLayer({"robot", 1}, {1, 1});
  layer.BeginCommit();
  for (int k = 0; k < 50; ++k)
    layer.EditTile(RandomKey(random, 100000)) = RandomTile(random, map_.options().limits);
  const auto problems = MapFile::WriteNew(path_, map_.Layers());
  ASSERT_TRUE(problems.ok()) << problems.status();
  EXPECT_TRUE(problems->empty());
  const std::filesystem::directory_iterator begin(directory_.path());
  EXPECT_EQ(std::distance(begin, {}), 1);
  const auto loaded = ReadMapFile(path_);
  ASSERT_TRUE(loaded.ok()) << loaded.status();
  EXPECT_TRUE(loaded->corruption.empty());
  ExpectEqual(loaded->set, map_.Layers());
  // It is a file like others: saves go on in it.
  auto file = MapFile::Open(path_);
  ASSERT_TRUE(file->Load().ok());
  Commit(layer, 3);
  ASSERT_TRUE(file->Save(map_.Layers()).ok());
  ExpectEqual(ReadMapFile(path_)->set, map_.Layers());
}

TEST_F(MapFileTest, AFileThatHasAMapIsNoNewFileAndStays) {
  map_.AddLayer({"robot", 1}, {1, 1});
  ASSERT_TRUE(MapFile::WriteNew(path_, map_.Layers()).ok());
  EXPECT_TRUE(absl::IsFailedPrecondition(MapFile::WriteNew(path_, {}).status()));
  ExpectEqual(ReadMapFile(path_)->set, map_.Layers());
}

TEST_F(MapFileTest, SavesOfChangesAddUpToTheMap) {
  std::mt19937_64 random(2);
  Layer& layer = map_.AddLayer({"robot", 1}, {1, 1});
  auto file = MapFile::Open(path_);
  for (int n = 0; n < 30; ++n) {
    layer.BeginCommit();
    layer.EditTile(RandomKey(random, 4)) = RandomTile(random, map_.options().limits);
    if (n % 3 == 0) {
      ASSERT_TRUE(file->Save(map_.Layers()).ok());
      ExpectEqual(ReadMapFile(path_)->set, map_.Layers());
    }
  }
}

TEST_F(MapFileTest, ASecondSessionGoesOnSaving) {
  Commit(map_.AddLayer({"robot", 1}, {1, 1}), 5);
  ASSERT_TRUE(MapFile::Open(path_)->Save(map_.Layers()).ok());
  auto file = MapFile::Open(path_);
  const auto loaded = file->Load();
  MapWriter next(loaded->set.options);
  Layer& layer = next.ContinueLayer(loaded->set.layers[0], {2, 2});
  layer.BeginCommit();
  layer.EditTile({9, 9}).control_points[0] = 3;
  ASSERT_TRUE(file->Save(next.Layers()).ok());
  ExpectEqual(ReadMapFile(path_)->set, next.Layers());
}

TEST_F(MapFileTest, ALayerThatBeganAnewAndGrewLargerLeavesNothingOld) {
  Layer& layer = map_.AddLayer({"robot", 1}, {1, 7});
  Commit(layer, 100);
  auto file = MapFile::Open(path_);
  ASSERT_TRUE(file->Save(map_.Layers()).ok());
  layer.StartEmptySession({2, 8});
  layer.BeginCommit();
  for (int k = 0; k < 20; ++k) layer.EditTile({k, 50}).control_points[0] = 3;
  ASSERT_TRUE(file->Save(map_.Layers()).ok());
  const auto loaded = ReadMapFile(path_);
  EXPECT_TRUE(loaded->corruption.empty());
  ExpectEqual(loaded->set, map_.Layers());
}

TEST_F(MapFileTest, ALayerThatIsGoneIsGoneFromTheFileAndTheOthersStay) {
  Layer& layer = map_.AddLayer({"robot", 1}, {1, 7});
  Commit(layer, 100);
  Commit(map_.AddLayer({"other", 2}, {1, 8}), 50);
  auto file = MapFile::Open(path_);
  ASSERT_TRUE(file->Save(map_.Layers()).ok());
  Commit(layer, 101);
  LayerSet without = map_.Layers();
  without.layers.pop_back();
  ASSERT_TRUE(file->Save(without).ok());
  const auto loaded = ReadMapFile(path_);
  EXPECT_TRUE(loaded->corruption.empty());
  ExpectEqual(loaded->set, without);
}

TEST_F(MapFileTest, SettingsOfLayersAndWhoseFileItIsAreKept) {
  const LayerId id{"robot", 1};
  Commit(map_.AddLayer(id, {1, 7}), 100);
  Commit(map_.AddLayer({"other", 2}, {1, 8}), 50);
  map_.SetOwnLayer(id);
  SettingsTable settings;
  LayerSettings setting = settings.Next(id, 77);
  setting.placement = ShiftBy(-40, 33, 0.1);
  settings.Merge(id, setting);
  setting = settings.Next({"other", 2}, 78);
  setting.low_weight = true;
  setting.placement = PlacedAt(-1000.123, 7, -123.4);
  settings.Merge({"other", 2}, setting);
  settings.Merge({"gone", 3}, settings.Removal({"gone", 3}, {12, 1}, 79));
  map_.SetSettings(settings);
  ASSERT_TRUE(MapFile::Open(path_)->Save(map_.Layers()).ok());
  const auto loaded = ReadMapFile(path_);
  ExpectEqual(loaded->set, map_.Layers());
  const auto view = ViewOf(loaded->set);
  const auto placed = FindTile(view->tiles, {-4, 2});
  ASSERT_NE(placed, nullptr);
  EXPECT_EQ(placed->control_points[IndexInTile(0, 0)], 0);
  EXPECT_EQ(placed->control_points[IndexInTile(0, 1)], 100);
  EXPECT_EQ(loaded->set.settings.Of({"gone", 3}).removed_up_to, (uint64_t{1} << 20) - 1);
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
        if (!file->Save(map_.Layers()).ok()) _exit(1);
      }
    }
    while (true) {  // until a first save is there, then a little longer
      const auto file = ReadMapFile(path_);
      if (file.ok() && ViewOf(file->set)->tiles.size() > 0) break;
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
    EXPECT_TRUE(loaded->corruption.empty());
    const auto view = ViewOf(loaded->set);
    ASSERT_EQ(view->tiles.size(), 40u);
    const ControlPoint value = FindTile(view->tiles, {0, 0})->control_points[0];
    view->tiles.ForEach([&](TileKey, const TileTree::Entry& entry) {
      const auto tile = entry.tile->Get();
      for (const ControlPoint c : tile->control_points) ASSERT_EQ(c, value);
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
  ASSERT_TRUE(file->Save(map_.Layers()).ok());
  const auto before = ReadMapFile(path_);
  Commit(layer, 6);
  {
    SQLite::Database other(path_, SQLite::OPEN_READWRITE);
    other.exec(
        "CREATE TRIGGER full BEFORE INSERT ON tile BEGIN SELECT RAISE(FAIL, 'disk full'); END");
    const absl::Status status = file->Save(map_.Layers()).status();
    EXPECT_NE(ErrorText(status).find("disk full"), std::string::npos) << status;
    other.exec("DROP TRIGGER full");
  }
  ExpectEqual(ReadMapFile(path_)->set, before->set);
  ASSERT_TRUE(file->Save(map_.Layers()).ok());
  ExpectEqual(ReadMapFile(path_)->set, map_.Layers());
}

TEST_F(MapFileTest, ADamagedTileIsReportedAndTheRestIsLoaded) {
  Commit(map_.AddLayer({"robot", 1}, {1, 1}), 5);
  ASSERT_TRUE(MapFile::Open(path_)->Save(map_.Layers()).ok());
  {
    SQLite::Database database(path_, SQLite::OPEN_READWRITE);
    database.exec("UPDATE tile SET checksum = checksum + 1 WHERE tx = 2");
    database.exec("UPDATE tile SET content = x'00' WHERE tx = 3");
    database.exec("UPDATE tile SET revision = -1 WHERE tx = 1");
    // A tile whose checksum is right and whose key no tree can hold.
    const TileUpdate far = MakeTileUpdate({2147483647, 0}, {}, 1);
    SQLite::Statement odd(database,
                          "UPDATE tile SET tx = ?, checksum = ?, content = ? WHERE tx = -1");
    odd.bind(1, far.key.tx);
    odd.bind(2, static_cast<int64_t>(far.checksum));
    odd.bind(3, far.content.data(), static_cast<int>(far.content.size()));
    odd.exec();
  }
  const auto loaded = ReadMapFile(path_);
  ASSERT_TRUE(loaded.ok()) << loaded.status();
  EXPECT_EQ(loaded->corruption.size(), 4u);
  EXPECT_EQ(ViewOf(loaded->set)->tiles.size(), 3u);
}

TEST_F(MapFileTest, WhatIsMissingIsReported) {
  for (const char* statement :
       {"DELETE FROM tile WHERE tx = 1", "UPDATE tile SET layer = 7 WHERE layer = 2",
        "UPDATE tile SET revision = 1 WHERE tx = 0", "DELETE FROM layer WHERE id = 2",
        "DELETE FROM tile_square WHERE tree = 2", "UPDATE tile_square SET x = 5 WHERE tree = 1",
        "UPDATE tile_square SET checksum = 0"}) {
    std::filesystem::remove(path_);
    MapWriter map({0.1, {-2560, 5120}});
    for (const uint64_t origin : {1, 2}) {
      Layer& layer = map.AddLayer({"robot", origin}, {1, 1});
      Commit(layer, 3);
      Commit(layer, 6);
    }
    ASSERT_TRUE(MapFile::Open(path_)->Save(map.Layers()).ok());
    EXPECT_TRUE(ReadMapFile(path_)->corruption.empty());
    SQLite::Database(path_, SQLite::OPEN_READWRITE).exec(statement);
    const auto loaded = ReadMapFile(path_);
    ASSERT_TRUE(loaded.ok()) << loaded.status();
    EXPECT_FALSE(loaded->corruption.empty()) << statement;
  }
}

TEST_F(MapFileTest, TheNextSaveMendsADamagedMap) {
  Commit(map_.AddLayer({"robot", 1}, {1, 1}), 5);
  ASSERT_TRUE(MapFile::Open(path_)->Save(map_.Layers()).ok());
  SQLite::Database(path_, SQLite::OPEN_READWRITE)
      .exec("UPDATE tile SET content = x'00' WHERE tx = 3");
  auto file = MapFile::Open(path_);
  const auto loaded = file->Load();
  ASSERT_EQ(loaded->corruption.size(), 1u);
  ASSERT_TRUE(file->Save(loaded->set).ok());
  const auto again = ReadMapFile(path_);
  EXPECT_TRUE(again->corruption.empty());
  ExpectEqual(again->set, loaded->set);
  EXPECT_EQ(ReadMapFile(loaded->kept_copy)->corruption.size(), 1u);
  EXPECT_TRUE(absl::IsFailedPrecondition(MapFile::Open(path_).status())) << "still in use";
  Commit(map_.layer(0), 6);
  ASSERT_TRUE(file->Save(map_.Layers()).ok());
  ExpectEqual(ReadMapFile(path_)->set, map_.Layers());
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
  ASSERT_TRUE(file->Save(map_.Layers()).ok());
  std::filesystem::remove(path_);
  EXPECT_TRUE(absl::IsFailedPrecondition(file->Save(map_.Layers()).status()));
  std::ofstream(path_) << "another";
  EXPECT_TRUE(absl::IsFailedPrecondition(file->Save(map_.Layers()).status()));
}

TEST_F(MapFileTest, AFileThatWasDeletedOrReplacedIsSavedElsewhereAndLeavesTheOtherAlone) {
  Layer& layer = map_.AddLayer({"robot", 1}, {1, 1});
  const std::string rescue = directory_.File("rescue");
  for (const bool is_replaced : {false, true}) {
    std::filesystem::remove(path_);
    auto file = MapFile::Open(path_);
    Commit(layer, 5);
    ASSERT_TRUE(file->Save(map_.Layers()).ok());
    std::filesystem::remove(path_);
    if (is_replaced) std::filesystem::copy_file(TestData("map_of_schema_2"), path_);
    EXPECT_FALSE(file->IsThere());
    Commit(layer, 6);
    EXPECT_EQ(file->SaveElsewhere(path_, map_.Layers()).ok(), !is_replaced);
    if (is_replaced) {
      ASSERT_TRUE(file->SaveElsewhere(rescue, map_.Layers()).ok());
      EXPECT_EQ(ReadMapFile(path_)->set.layers.size(), 2u);  // and no mixture
      EXPECT_TRUE(ReadMapFile(path_)->corruption.empty());
    }
    EXPECT_EQ(file->path(), is_replaced ? rescue : path_);
    Commit(layer, 7);
    ASSERT_TRUE(file->Save(map_.Layers()).ok());
    ExpectEqual(ReadMapFile(file->path())->set, map_.Layers());
  }
}

TEST_F(MapFileTest, ACopyOfTheFileInUseHasASaveOfTheLastSeconds) {
  Commit(map_.AddLayer({"robot", 1}, {1, 1}), 5);
  auto file = MapFile::Open(path_);
  ASSERT_TRUE(file->Save(map_.Layers()).ok());
  const std::string copy = directory_.File("copy");
  std::filesystem::copy_file(path_, copy);
  ExpectEqual(ReadMapFile(copy)->set, map_.Layers());
}

TEST_F(MapFileTest, ACopyByPagesHasTheLastSaveInOneFile) {
  Layer& layer = map_.AddLayer({"robot", 1}, {1, 1});
  Commit(layer, 5);
  auto file = MapFile::Open(path_);
  ASSERT_TRUE(file->Save(map_.Layers()).ok());
  auto reader = MapFile::OpenReadOnly(path_);  // so that later saves stay beside the file
  ASSERT_TRUE(reader->Load().ok());
  Commit(layer, 6);
  ASSERT_TRUE(file->Save(map_.Layers()).ok());
  const std::string copy = directory_.File("copy");
  ASSERT_TRUE(MapFile::Copy(path_, copy).ok());
  for (const char* beside : {"-wal", "-shm", "-journal"}) {
    EXPECT_FALSE(std::filesystem::exists(copy + beside));
  }
  ExpectEqual(ReadMapFile(copy)->set, map_.Layers());
  EXPECT_TRUE(absl::IsNotFound(MapFile::Copy(directory_.File("none"), copy)));
}

TEST_F(MapFileTest, ClosedWhileSomeoneReadsTheOneFileHasEverything) {
  Commit(map_.AddLayer({"robot", 1}, {1, 1}), 5);
  auto file = MapFile::Open(path_);
  ASSERT_TRUE(file->Save(map_.Layers()).ok());
  auto reader = MapFile::OpenReadOnly(path_);
  ASSERT_TRUE(reader->Load().ok());
  EXPECT_TRUE(file->Close().ok());
  EXPECT_TRUE(absl::IsFailedPrecondition(file->Close()));
  const std::string copy = directory_.File("copy");
  std::filesystem::copy_file(path_, copy);
  ExpectEqual(ReadMapFile(copy)->set, map_.Layers());
}

TEST_F(MapFileTest, ANameMayBeAnyBytes) {
  map_.AddLayer({"B\xfcro \x01", 1}, {1, 1});
  ASSERT_TRUE(MapFile::Open(path_)->Save(map_.Layers()).ok());
  ExpectEqual(ReadMapFile(path_)->set, map_.Layers());
}

TEST_F(MapFileTest, ADamagedRecordOfTheMapOrOfALayerIsReadFromItsCopy) {
  Commit(map_.AddLayer({"robot", 1}, {1, 1}), 5);
  Commit(map_.AddLayer({"other", 2}, {7, 8}), 6);
  map_.SetOwnLayer({"other", 2});
  SettingsTable settings;
  settings.Merge({"gone", 3}, settings.Removal({"gone", 3}, {12, 1}, 79));
  map_.SetSettings(settings);
  for (const char* statement :
       {"UPDATE map SET record = x''", "DELETE FROM map", "UPDATE layer SET record = x'' ",
        "DELETE FROM layer", "UPDATE layer SET record = x'' WHERE id = 2"}) {
    std::filesystem::remove(path_);
    ASSERT_TRUE(MapFile::Open(path_)->Save(map_.Layers()).ok());
    SQLite::Database(path_, SQLite::OPEN_READWRITE).exec(statement);
    const auto loaded = ReadMapFile(path_);
    ASSERT_TRUE(loaded.ok()) << statement << loaded.status();
    EXPECT_FALSE(loaded->corruption.empty()) << statement;
    ExpectEqual(loaded->set, map_.Layers());
  }
  SQLite::Database(path_, SQLite::OPEN_READWRITE).exec("DELETE FROM layer; DELETE FROM map");
  EXPECT_TRUE(absl::IsDataLoss(ReadMapFile(path_).status()));  // and not a map that begins
}

// Saves a map with what cannot be; the file is whole, and has all else.
TEST_F(MapFileTest, WhatCannotBeIsLeftOutAndSaidAndTheRestIsSaved) {
  constexpr uint64_t kMax = kMaxRevision;
  Layer& sane = map_.AddLayer({"sane", 1}, {1, 1});
  Commit(sane, 5);
  SettingsTable settings;
  LayerSettings sane_setting;
  sane_setting.counter = kMax;
  settings.Merge({"sane", 1}, sane_setting);
  map_.SetSettings(settings);
  const LayerSet sane_map = map_.Layers();
  std::vector<std::pair<std::string, LayerSet>> cases;
  const auto add = [&](std::string what, auto change) {
    LayerSet map = sane_map;
    change(map);
    cases.emplace_back(std::move(what), std::move(map));
  };
  const auto add_setting = [&](const std::string& what, LayerSettings setting) {
    add(what, [&](LayerSet& map) { map.settings.Merge({"x", 9}, setting); });
  };
  const auto add_layer = [&](const std::string& what, LayerId id, SessionId session,
                             uint64_t revision) {
    add(what, [&](LayerSet& map) {
      Layer layer(std::move(id), session);
      layer.RestoreTile({1, 1}, std::make_shared<const StoredTile>(), 1);
      map.layers.insert(map.layers.begin(), layer.Snapshot());
      map.layers.front().revision = revision;
    });
  };
  for (const uint64_t value : {kMax + 1, uint64_t{1} << 62, ~uint64_t{0} >> 1, ~uint64_t{0}}) {
    add_layer("session_number", {"x", 9}, {value, 1}, 1);
    add_layer("revision", {"x", 9}, {1, 1}, value);
    LayerSettings setting;
    setting.counter = value;
    add_setting("counter", setting);
    setting.counter = 0;
    setting.removed_up_to = value;
    add_setting("removed_up_to", setting);
  }
  add_layer("no name", {"", 9}, {1, 1}, 1);
  add_layer("long name", {std::string(257, 'x'), 9}, {1, 1}, 1);
  add_layer("0 in a name", {std::string("a\0b", 3), 9}, {1, 1}, 1);
  add_layer("twice", {"sane", 1}, {1, 1}, 1);
  constexpr int64_t kMost = FixedPose2::kMaxUnits;
  for (const int64_t units : {kMost + 1, -kMost - 1, INT64_MIN, INT64_MAX}) {
    for (const FixedPose2& placement : {FixedPose2{.x = units}, FixedPose2{.y = units}}) {
      LayerSettings setting;
      setting.placement = placement;
      add_setting("placement", setting);
    }
  }
  add("a setting about nobody", [&](LayerSet& map) { map.settings.Merge({"", 9}, sane_setting); });
  for (const auto& [what, map] : cases) {
    SCOPED_TRACE(what);
    std::filesystem::remove(path_);
    const auto problems = MapFile::Open(path_)->Save(map);
    ASSERT_TRUE(problems.ok()) << problems.status();
    EXPECT_EQ(problems->size(), 1u);
    const auto loaded = ReadMapFile(path_);
    ASSERT_TRUE(loaded.ok()) << loaded.status();
    EXPECT_TRUE(loaded->corruption.empty()) << loaded->corruption.front();
    if (what == "twice") continue;  // one of them is there
    ExpectEqual(loaded->set, sane_map);
  }
}

TEST_F(MapFileTest, TilesThatCannotBeAreLeftOutUntilTheyCan) {
  Layer& layer = map_.AddLayer({"robot", 1}, {1, 1});
  Commit(layer, 5);
  auto file = MapFile::Open(path_);
  ASSERT_TRUE(file->Save(map_.Layers())->empty());
  Commit(layer, 8);  // other tiles of the row
  layer.EditTile({2, 2}).control_points[7] = 5121;
  layer.EditTile({-2, 2}).control_points[7] = -2561;
  const auto problems = file->Save(map_.Layers());
  ASSERT_TRUE(problems.ok()) << problems.status();
  ASSERT_EQ(problems->size(), 1u);
  EXPECT_NE(problems->front().find("2 tiles of layer robot"), std::string::npos)
      << problems->front();
  for (int round = 0; round < 2; ++round) {
    const auto loaded = ReadMapFile(path_);
    EXPECT_TRUE(loaded->corruption.empty());
    EXPECT_EQ(loaded->set.layers[0].tiles.size(), 5u);
    layer.BeginCommit();
    EXPECT_EQ(file->Save(map_.Layers())->size(), 1u);  // said again, since it is so still
  }
  Commit(layer, 11);
  EXPECT_TRUE(file->Save(map_.Layers())->empty());
  const auto loaded = ReadMapFile(path_);
  EXPECT_TRUE(loaded->corruption.empty());
  ExpectEqual(loaded->set, map_.Layers());
}

TEST_F(MapFileTest, OptionsThatCannotBeAreRefusedAndTheFileStays) {
  Commit(map_.AddLayer({"robot", 1}, {1, 1}), 5);
  auto file = MapFile::Open(path_);
  ASSERT_TRUE(file->Save(map_.Layers()).ok());
  for (const double interval : {0.0, -1.0, 1e-320, 1e300, std::nan(""), HUGE_VAL}) {
    LayerSet map = map_.Layers();
    map.options.knot_interval_m = interval;
    EXPECT_TRUE(absl::IsInvalidArgument(file->Save(map).status())) << interval;
  }
  ExpectEqual(ReadMapFile(path_)->set, map_.Layers());
}

// As a disk leaves it that loses what it has synced.
TEST_F(MapFileTest, RecordsOfDifferentSavesAreReported) {
  Layer& layer = map_.AddLayer({"robot", 1}, {1, 7});
  Commit(layer, 5);
  auto file = MapFile::Open(path_);
  ASSERT_TRUE(file->Save(map_.Layers()).ok());
  SQLite::Database database(path_, SQLite::OPEN_READWRITE);
  for (const bool is_setting : {true, false}) {
    const std::string before = database.execAndGet("SELECT record FROM map").getString();
    if (is_setting) {
      SettingsTable settings;
      LayerSettings setting = settings.Next(layer.id(), 5);
      setting.muted = true;
      settings.Merge(layer.id(), setting);
      map_.SetSettings(settings);
    } else {
      layer.BeginCommit();  // which changes no tile
    }
    ASSERT_TRUE(file->Save(map_.Layers()).ok());
    ASSERT_TRUE(ReadMapFile(path_)->corruption.empty());
    const std::string after = database.execAndGet("SELECT record FROM map").getString();
    const auto put_record = [&](const std::string& bytes) {
      SQLite::Statement put(database, "UPDATE map SET record = ?");
      put.bind(1, bytes.data(), static_cast<int>(bytes.size()));
      put.exec();
    };
    put_record(before);
    EXPECT_FALSE(ReadMapFile(path_)->corruption.empty()) << is_setting;
    put_record(after);
  }
}

// Files of versions that wrote what none reads any more.
TEST_F(MapFileTest, OfARecordThatCannotBeOnlyThatIsLost) {
  Commit(map_.AddLayer({"robot", 1}, {5, 1}), 5);
  Commit(map_.AddLayer({"other", 2}, {5, 1}), 6);
  ASSERT_TRUE(MapFile::Open(path_)->Save(map_.Layers()).ok());
  const auto sealed = [](auto record) {
    record.clear_checksum();
    const std::string bytes = record.SerializeAsString();
    record.set_checksum(XXH3_64bits(bytes.data(), bytes.size()));
    return record.SerializeAsString();
  };
  {
    SQLite::Database database(path_, SQLite::OPEN_READWRITE);
    const auto rewrite = [&](auto record, const std::string& table, const auto& change) {
      ASSERT_TRUE(
          record.ParseFromString(database.execAndGet("SELECT record FROM " + table).getString()));
      change(record);
      const std::string bytes = sealed(record);
      SQLite::Statement put(database, "UPDATE " + table + " SET record = ? WHERE id = 1");
      put.bind(1, bytes.data(), static_cast<int>(bytes.size()));
      put.exec();
    };
    rewrite(store::LayerRecord(), "layer", [](store::LayerRecord& record) {
      record.set_revision(~uint64_t{0} >> 1);
      record.set_session_number(uint64_t{1} << 61 | 1);
    });
    rewrite(store::MapRecord(), "map", [](store::MapRecord& record) {
      for (const uint64_t counter : {uint64_t{4}, uint64_t{1} << 62}) {
        store::SettingsRecord& setting = *record.add_settings();
        setting.mutable_layer()->set_name(counter == 4 ? "sane" : "insane");
        setting.set_counter(counter);
      }
    });
  }
  const auto loaded = ReadMapFile(path_);
  ASSERT_TRUE(loaded.ok()) << loaded.status();
  EXPECT_EQ(loaded->corruption.size(), 3u + 2u);  // both records differ from their copies as well
  ASSERT_EQ(loaded->set.settings.records().size(), 1u);
  EXPECT_EQ(loaded->set.settings.records().begin()->first.name, "sane");
  const LayerSnapshot& layer = loaded->set.layers[0];
  EXPECT_EQ(layer.session, SessionId());
  EXPECT_EQ(layer.revision, 1u);
  EXPECT_EQ(ContentOf(layer.tiles), ContentOf(map_.Layers().layers[0].tiles));
  EXPECT_EQ(ContentOf(loaded->set.layers[1].tiles), ContentOf(map_.Layers().layers[1].tiles));
}

TEST_F(MapFileTest, AShiftOfAnEarlierVersionIsThatPlacement) {
  const LayerId id{"robot", 1};
  Commit(map_.AddLayer(id, {1, 7}), 100);
  ASSERT_TRUE(MapFile::Open(path_)->Save(map_.Layers()).ok());
  const auto read_with_shift = [&](int32_t i, int32_t j) {
    {
      SQLite::Database database(path_, SQLite::OPEN_READWRITE);
      store::MapRecord record;
      EXPECT_TRUE(
          record.ParseFromString(database.execAndGet("SELECT record FROM map").getString()));
      record.clear_settings();
      store::SettingsRecord& setting = *record.add_settings();
      setting.mutable_layer()->set_name(id.name);
      setting.mutable_layer()->set_origin(id.origin);
      setting.set_counter(3);
      setting.set_shift_i(i);
      setting.set_shift_j(j);
      record.clear_checksum();
      std::string bytes = record.SerializeAsString();
      record.set_checksum(XXH3_64bits(bytes.data(), bytes.size()));
      bytes = record.SerializeAsString();
      SQLite::Statement put(database, "UPDATE map SET record = ?");
      put.bind(1, bytes.data(), static_cast<int>(bytes.size()));
      put.exec();
      // Without the copy of it, which says otherwise.
      store::LayerRecord layer;
      EXPECT_TRUE(
          layer.ParseFromString(database.execAndGet("SELECT record FROM layer").getString()));
      layer.clear_map();
      layer.clear_checksum();
      bytes = layer.SerializeAsString();
      layer.set_checksum(XXH3_64bits(bytes.data(), bytes.size()));
      bytes = layer.SerializeAsString();
      SQLite::Statement put_layer(database, "UPDATE layer SET record = ?");
      put_layer.bind(1, bytes.data(), static_cast<int>(bytes.size()));
      put_layer.exec();
    }
    return *ReadMapFile(path_);
  };
  constexpr int32_t kMost = 1 << 26;  // that could be
  for (const auto& [i, j] : {std::pair(-40, 33), {0, 1}, {kMost, -kMost}}) {
    const LoadedMap loaded = read_with_shift(i, j);
    EXPECT_TRUE(loaded.corruption.empty());
    const FixedPose2& placement = loaded.set.settings.Of(id).placement;
    EXPECT_EQ(placement, ShiftBy(i, j, 0.1));
    EXPECT_FALSE(IsApproximate(placement, loaded.set.options.knot_interval_m));
    const auto view = ViewOf(loaded.set);
    const auto placed = FindTile(view->tiles, TileOf(i, j + 32));
    ASSERT_NE(placed, nullptr);
    EXPECT_EQ(placed->control_points[IndexInTile(i, j)], 100);
  }
  const LoadedMap loaded = read_with_shift(INT32_MAX, 0);
  EXPECT_EQ(loaded.corruption.size(), 1u);
  EXPECT_TRUE(loaded.set.settings.records().empty());
}

class EarlierSchemaTest : public MapFileTest, public testing::WithParamInterface<int> {};
INSTANTIATE_TEST_SUITE_P(, EarlierSchemaTest, testing::Values(2, 5));

TEST_P(EarlierSchemaTest, IsReadAndContinued) {
  std::filesystem::copy_file(TestData(fmt::format("map_of_schema_{}", GetParam())), path_);
  ASSERT_EQ(SQLite::Database(path_).execAndGet("PRAGMA user_version").getInt(), GetParam());
  auto file = MapFile::Open(path_);
  const auto loaded = file->Load();
  ASSERT_TRUE(loaded.ok()) << loaded.status();
  EXPECT_TRUE(loaded->corruption.empty());
  MapWriter map(loaded->set.options);
  for (const LayerSnapshot& layer : loaded->set.layers) {
    Commit(map.ContinueLayer(layer, layer.session), 3);
  }
  ASSERT_TRUE(file->Save(map.Layers())->empty());
  const auto again = ReadMapFile(path_);
  EXPECT_TRUE(again->corruption.empty());
  ExpectEqual(again->set, map.Layers());
  EXPECT_EQ(SQLite::Database(path_).execAndGet("PRAGMA user_version").getInt(), 6);
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
    ASSERT_TRUE(MapFile::Open(path_)->Save(map_.Layers()).ok());
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
  ASSERT_TRUE(MapFile::Open(path_)->Save(map_.Layers()).ok());
  SQLite::Database(path_, SQLite::OPEN_READWRITE).exec("PRAGMA user_version = 7");
  EXPECT_NE(ErrorText(MapFile::Open(path_).status()).find("a newer splinemap"), std::string::npos);
  SQLite::Database(path_, SQLite::OPEN_READWRITE).exec("PRAGMA user_version = 1");
  EXPECT_NE(ErrorText(ReadMapFile(path_).status()).find("an older splinemap"), std::string::npos);
}

}  // namespace splinemap::map_file_test
