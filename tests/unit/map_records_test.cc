#include "lib/store/map_records.h"

#include <SQLiteCpp/SQLiteCpp.h>
#include <gtest/gtest.h>

#include "tests/support/map_file_fixture.h"
#include "tests/support/map_writer.h"

namespace splinemap::map_records_test {

class MapRecordsTest : public MapFileTest {
 protected:
  MapRecordsTest() { MakeSchema(database_); }

  // Writes the map as it is now; returns the number of rows that were written or deleted.
  int64_t Write() {
    SQLite::Transaction transaction(database_);
    const int64_t before = database_.getTotalChanges();
    MapRowWriter writer(rows_, database_);
    std::vector<std::string> problems;
    writer.Write(map_.Layers(), saved_, problems);
    EXPECT_TRUE(problems.empty());
    const int64_t rows = database_.getTotalChanges() - before;
    transaction.commit();
    MapRowWriter::Written written = writer.Finish();
    for (const auto& [tile, number] : written.numbers) tile->SetSource(rows_, number);
    saved_ = std::move(written.saved);
    EXPECT_EQ(CountTiles(), rows_->num_rows());
    return rows;
  }

  void ExpectThatReadersSeeTheMap() {
    const auto read = ReadMap("map", database_, [](ControlLimits) { return nullptr; });
    ASSERT_TRUE(read.ok()) << read.status();
    EXPECT_TRUE(read->map.corruption.empty());
    ExpectEqual(read->map.set, map_.Layers());
  }

  static void CommitMany(Layer& layer, int tiles) {
    layer.BeginCommit();
    for (int k = 0; k < tiles; ++k) layer.EditTile({k % 200, k / 200}).control_points[0] = 3;
  }

  int64_t CountTiles() { return database_.execAndGet("SELECT count(*) FROM tile").getInt64(); }

  SQLite::Database database_{":memory:", SQLite::OPEN_READWRITE};
  const std::shared_ptr<TileRows> rows_ =
      std::make_shared<TileRows>("", MapOptions().limits, nullptr);
  std::vector<SavedLayer> saved_;
};

TEST_F(MapRecordsTest, AnotherSessionOfALayerCostsItsRowAndWhatChanged) {
  Layer& layer = map_.AddLayer({"robot", 1}, {1, 1});
  CommitMany(map_.AddLayer({"other", 2}, {1, 1}), 100);
  CommitMany(layer, 8000);
  EXPECT_GT(Write(), 8100);
  layer.StartSession({"robot", 1}, {2, 9});
  EXPECT_LT(Write(), 10);
  ExpectThatReadersSeeTheMap();
  layer.StartSession({"robot", 77}, {1, 9});  // another origin, as after a clone was heard
  CommitMany(layer, 5);
  EXPECT_LT(Write(), 8000 / 20);  // squares, and no tile but those that changed
  ExpectThatReadersSeeTheMap();
  layer.BeginCommit();
  EXPECT_LT(Write(), 20);
  EXPECT_EQ(CountTiles(), 8100);
}

TEST_F(MapRecordsTest, TwoLayersThatChangeTheirNamesKeepTheirTiles) {
  Layer& a = map_.AddLayer({"a", 1}, {1, 1});
  Layer& b = map_.AddLayer({"b", 1}, {1, 1});
  CommitMany(a, 1000);
  CommitMany(b, 10);
  Write();
  a.StartSession({"b", 1}, {1, 1});
  b.StartSession({"a", 1}, {1, 1});
  EXPECT_LT(Write(), 150);  // squares, and no tile
  ExpectThatReadersSeeTheMap();
}

TEST_F(MapRecordsTest, AnEmptySessionBeginsAtOnceAndOldTilesGoInPortions) {
  Layer& layer = map_.AddLayer({"robot", 1}, {1, 1});
  CommitMany(layer, 30'000);
  Write();
  int saves = 0;
  for (uint64_t number = 2; number < 5; ++number) {
    layer.StartEmptySession({number, 1});
    CommitMany(layer, 7);
    EXPECT_LT(Write(), 5000);
    ExpectThatReadersSeeTheMap();
  }
  while (CountTiles() > 7 && saves < 20) {
    layer.BeginCommit();
    EXPECT_LT(Write(), 5000);
    ExpectThatReadersSeeTheMap();
    ++saves;
  }
  EXPECT_EQ(CountTiles(), 7);
}

// A layer that is gone leaves tiles for a while, and another one does not get its number.
TEST_F(MapRecordsTest, TilesOfALayerThatIsGoneAreNobodyElses) {
  CommitMany(map_.AddLayer({"robot", 1}, {1, 1}), 10'000);
  Write();
  map_ = MapWriter(map_.options());
  CommitMany(map_.AddLayer({"other", 2}, {1, 1}), 3);
  Write();
  EXPECT_GT(CountTiles(), 3);
  ExpectThatReadersSeeTheMap();
}

}  // namespace splinemap::map_records_test
