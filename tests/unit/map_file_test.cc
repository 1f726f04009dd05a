#include "lib/store/map_file.h"

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
#include "lib/map/tile_update.h"
#include "lib/store/records.pb.h"
#include "tests/support/map_file_fixture.h"
#include "tests/support/random_map.h"
#include "tests/support/shared_data.h"

namespace splinemap::map_file_test {

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
    const absl::Status status = file->Save(*map_.Snapshot()).status();
    EXPECT_NE(ErrorText(status).find("disk full"), std::string::npos) << status;
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
  EXPECT_EQ(ReadMapFile(loaded->kept_copy)->damages.size(), 1u);
  EXPECT_TRUE(absl::IsFailedPrecondition(MapFile::Open(path_).status())) << "still in use";
  Commit(map_.layer(0), 6);
  ASSERT_TRUE(file->Save(*map_.Snapshot()).ok());
  ExpectEqual(*ReadMapFile(path_)->map, *map_.Snapshot());
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
  EXPECT_TRUE(absl::IsFailedPrecondition(file->Save(*map_.Snapshot()).status()));
  std::ofstream(path_) << "another";
  EXPECT_TRUE(absl::IsFailedPrecondition(file->Save(*map_.Snapshot()).status()));
}

TEST_F(MapFileTest, AFileThatWasDeletedOrReplacedIsSavedElsewhereAndLeavesTheOtherAlone) {
  Layer& layer = map_.AddLayer({"robot", 1}, {1, 1});
  const std::string rescue = directory_.File("rescue");
  for (const bool is_replaced : {false, true}) {
    std::filesystem::remove(path_);
    auto file = MapFile::Open(path_);
    Commit(layer, 5);
    ASSERT_TRUE(file->Save(*map_.Snapshot()).ok());
    std::filesystem::remove(path_);
    if (is_replaced) std::filesystem::copy_file(TestData("map_of_schema_2"), path_);
    EXPECT_FALSE(file->IsThere());
    Commit(layer, 6);
    EXPECT_EQ(file->SaveElsewhere(path_, *map_.Snapshot()).ok(), !is_replaced);
    if (is_replaced) {
      ASSERT_TRUE(file->SaveElsewhere(rescue, *map_.Snapshot()).ok());
      EXPECT_EQ(ReadMapFile(path_)->map->layers.size(), 2u);  // and no mixture
      EXPECT_TRUE(ReadMapFile(path_)->damages.empty());
    }
    EXPECT_EQ(file->path(), is_replaced ? rescue : path_);
    Commit(layer, 7);
    ASSERT_TRUE(file->Save(*map_.Snapshot()).ok());
    ExpectEqual(*ReadMapFile(file->path())->map, *map_.Snapshot());
  }
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

TEST_F(MapFileTest, ADamagedRecordOfTheMapOrOfALayerIsReadFromItsCopy) {
  Commit(map_.AddLayer({"robot", 1}, {1, 1}), 5);
  Commit(map_.AddLayer({"other", 2}, {7, 8}), 6);
  map_.SetOwnLayer({"other", 2});
  LayerControls controls;
  controls.Take({"gone", 3}, controls.Removal({"gone", 3}, 12, 79));
  map_.SetControls(controls);
  for (const char* statement :
       {"UPDATE map SET record = x''", "DELETE FROM map", "UPDATE layer SET record = x'' ",
        "DELETE FROM layer", "UPDATE layer SET record = x'' WHERE id = 2"}) {
    std::filesystem::remove(path_);
    ASSERT_TRUE(MapFile::Open(path_)->Save(*map_.Snapshot()).ok());
    SQLite::Database(path_, SQLite::OPEN_READWRITE).exec(statement);
    const auto loaded = ReadMapFile(path_);
    ASSERT_TRUE(loaded.ok()) << statement << loaded.status();
    EXPECT_FALSE(loaded->damages.empty()) << statement;
    ExpectEqual(*loaded->map, *map_.Snapshot());
  }
  SQLite::Database(path_, SQLite::OPEN_READWRITE).exec("DELETE FROM layer; DELETE FROM map");
  EXPECT_TRUE(absl::IsDataLoss(ReadMapFile(path_).status()));  // and not a map that begins
}

// Saves a map with what cannot be; the file is whole, and has all else.
TEST_F(MapFileTest, WhatCannotBeIsLeftOutAndSaidAndTheRestIsSaved) {
  constexpr uint64_t kMax = kMaxRevision;
  Layer& sane = map_.AddLayer({"sane", 1}, {1, 1});
  Commit(sane, 5);
  LayerControls controls;
  LayerControl decision;
  decision.counter = kMax;
  controls.Take({"sane", 1}, decision);
  map_.SetControls(controls);
  const auto sane_map = map_.Snapshot();
  std::vector<std::pair<std::string, MapSnapshot>> cases;
  const auto add = [&](std::string what, auto change) {
    MapSnapshot map = *sane_map;
    change(map);
    cases.emplace_back(std::move(what), std::move(map));
  };
  const auto add_decision = [&](const std::string& what, LayerControl control) {
    add(what, [&](MapSnapshot& map) { map.controls.Take({"x", 9}, control); });
  };
  const auto add_layer = [&](const std::string& what, LayerId id, LayerEpoch epoch,
                             uint64_t revision) {
    add(what, [&](MapSnapshot& map) {
      Layer layer(std::move(id), epoch);
      layer.RestoreTile({1, 1}, std::make_shared<const Tile>(), 1);
      map.layers.insert(map.layers.begin(), layer.Snapshot());
      map.layers.front().revision = revision;
    });
  };
  for (const uint64_t value : {kMax + 1, uint64_t{1} << 62, ~uint64_t{0} >> 1, ~uint64_t{0}}) {
    add_layer("incarnation", {"x", 9}, {value, 1}, 1);
    add_layer("revision", {"x", 9}, {1, 1}, value);
    LayerControl control;
    control.counter = value;
    add_decision("counter", control);
    control.counter = 0;
    control.removed_up_to = value;
    add_decision("removed_up_to", control);
  }
  add_layer("no name", {"", 9}, {1, 1}, 1);
  add_layer("long name", {std::string(257, 'x'), 9}, {1, 1}, 1);
  add_layer("0 in a name", {std::string("a\0b", 3), 9}, {1, 1}, 1);
  add_layer("twice", {"sane", 1}, {1, 1}, 1);
  for (const int32_t knots : {KnotShift::kMax + 1, -KnotShift::kMax - 1, INT32_MIN, INT32_MAX}) {
    for (const KnotShift shift : {KnotShift{knots, 0}, KnotShift{0, knots}}) {
      LayerControl control;
      control.shift = shift;
      add_decision("shift", control);
    }
  }
  for (const double value : {std::nan(""), HUGE_VAL, -HUGE_VAL}) {
    for (int k = 0; k < 3; ++k) {
      LayerControl control;
      control.alignment[k] = value;
      add_decision("alignment", control);
    }
  }
  add("a decision about nobody", [&](MapSnapshot& map) { map.controls.Take({"", 9}, decision); });
  for (const auto& [what, map] : cases) {
    SCOPED_TRACE(what);
    std::filesystem::remove(path_);
    const auto problems = MapFile::Open(path_)->Save(map);
    ASSERT_TRUE(problems.ok()) << problems.status();
    EXPECT_EQ(problems->size(), 1u);
    const auto loaded = ReadMapFile(path_);
    ASSERT_TRUE(loaded.ok()) << loaded.status();
    EXPECT_TRUE(loaded->damages.empty()) << loaded->damages.front();
    if (what == "twice") continue;  // one of them is there
    ExpectEqual(*loaded->map, *sane_map);
  }
}

TEST_F(MapFileTest, TilesThatCannotBeAreLeftOutUntilTheyCan) {
  Layer& layer = map_.AddLayer({"robot", 1}, {1, 1});
  Commit(layer, 5);
  auto file = MapFile::Open(path_);
  ASSERT_TRUE(file->Save(*map_.Snapshot())->empty());
  Commit(layer, 8);  // other tiles of the row
  layer.EditTile({2, 2}).control_points[7] = 5121;
  layer.EditTile({-2, 2}).control_points[7] = -2561;
  const auto problems = file->Save(*map_.Snapshot());
  ASSERT_TRUE(problems.ok()) << problems.status();
  ASSERT_EQ(problems->size(), 1u);
  EXPECT_NE(problems->front().find("2 tiles of layer robot"), std::string::npos)
      << problems->front();
  for (int round = 0; round < 2; ++round) {
    const auto loaded = ReadMapFile(path_);
    EXPECT_TRUE(loaded->damages.empty());
    EXPECT_EQ(loaded->map->layers[0].tiles.size(), 5u);
    layer.BeginCommit();
    EXPECT_EQ(file->Save(*map_.Snapshot())->size(), 1u);  // said again, since it is so still
  }
  Commit(layer, 11);
  EXPECT_TRUE(file->Save(*map_.Snapshot())->empty());
  const auto loaded = ReadMapFile(path_);
  EXPECT_TRUE(loaded->damages.empty());
  ExpectEqual(*loaded->map, *map_.Snapshot());
}

TEST_F(MapFileTest, OptionsThatCannotBeAreRefusedAndTheFileStays) {
  Commit(map_.AddLayer({"robot", 1}, {1, 1}), 5);
  auto file = MapFile::Open(path_);
  ASSERT_TRUE(file->Save(*map_.Snapshot()).ok());
  for (const double interval : {0.0, -1.0, 1e-320, 1e300, std::nan(""), HUGE_VAL}) {
    MapSnapshot map = *map_.Snapshot();
    map.options.knot_interval_m = interval;
    EXPECT_TRUE(absl::IsInvalidArgument(file->Save(map).status())) << interval;
  }
  ExpectEqual(*ReadMapFile(path_)->map, *map_.Snapshot());
}

// Files of versions that wrote what none reads any more.
TEST_F(MapFileTest, OfARecordThatCannotBeOnlyThatIsLost) {
  Commit(map_.AddLayer({"robot", 1}, {5, 1}), 5);
  Commit(map_.AddLayer({"other", 2}, {5, 1}), 6);
  ASSERT_TRUE(MapFile::Open(path_)->Save(*map_.Snapshot()).ok());
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
      record.set_incarnation(uint64_t{1} << 61 | 1);
    });
    rewrite(store::MapRecord(), "map", [](store::MapRecord& record) {
      for (const uint64_t counter : {uint64_t{4}, uint64_t{1} << 62}) {
        store::ControlRecord& control = *record.add_controls();
        control.mutable_layer()->set_name(counter == 4 ? "sane" : "insane");
        control.set_counter(counter);
      }
    });
  }
  const auto loaded = ReadMapFile(path_);
  ASSERT_TRUE(loaded.ok()) << loaded.status();
  EXPECT_EQ(loaded->damages.size(), 3u);
  ASSERT_EQ(loaded->map->controls.records().size(), 1u);
  EXPECT_EQ(loaded->map->controls.records().begin()->first.name, "sane");
  const LayerSnapshot& layer = loaded->map->layers[0];
  EXPECT_EQ(layer.epoch, LayerEpoch());
  EXPECT_EQ(layer.revision, 1u);
  EXPECT_EQ(ContentOf(layer.tiles), ContentOf(map_.Snapshot()->layers[0].tiles));
  EXPECT_EQ(ContentOf(loaded->map->layers[1].tiles), ContentOf(map_.Snapshot()->layers[1].tiles));
}

TEST_F(MapFileTest, AFileOfTheSchemaBeforeIsReadAndContinued) {
  std::filesystem::copy_file(TestData("map_of_schema_2"), path_);
  ASSERT_EQ(SQLite::Database(path_).execAndGet("PRAGMA user_version").getInt(), 2);
  auto file = MapFile::Open(path_);
  const auto loaded = file->Load();
  ASSERT_TRUE(loaded.ok()) << loaded.status();
  EXPECT_TRUE(loaded->damages.empty());
  Map map(loaded->map->options);
  for (const LayerSnapshot& layer : loaded->map->layers) {
    Commit(map.ContinueLayer(layer, layer.epoch), 3);
  }
  ASSERT_TRUE(file->Save(*map.Snapshot())->empty());
  const auto again = ReadMapFile(path_);
  EXPECT_TRUE(again->damages.empty());
  ExpectEqual(*again->map, *map.Snapshot());
  EXPECT_EQ(SQLite::Database(path_).execAndGet("PRAGMA user_version").getInt(), 3);
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
  SQLite::Database(path_, SQLite::OPEN_READWRITE).exec("PRAGMA user_version = 4");
  EXPECT_NE(ErrorText(MapFile::Open(path_).status()).find("a newer splinemap"), std::string::npos);
  SQLite::Database(path_, SQLite::OPEN_READWRITE).exec("PRAGMA user_version = 1");
  EXPECT_NE(ErrorText(ReadMapFile(path_).status()).find("an older splinemap"), std::string::npos);
}

}  // namespace splinemap::map_file_test
