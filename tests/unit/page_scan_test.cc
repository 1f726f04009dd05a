#include "lib/store/page_scan.h"

#include <SQLiteCpp/SQLiteCpp.h>
#include <gtest/gtest.h>

#include <filesystem>
#include <fstream>
#include <iterator>
#include <random>
#include <set>

#include "lib/base/status.h"
#include "splinemap/file.h"
#include "tests/support/map_file_fixture.h"
#include "tests/support/map_writer.h"
#include "tests/support/random_map.h"

namespace splinemap::page_scan_test {

constexpr size_t kPage = 4096;

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
      EXPECT_TRUE(file->Save(map_.Layers()).ok());
    }
    EXPECT_TRUE(file->Close().ok());
    std::ifstream in(path_, std::ios::binary);
    bytes_.assign(std::istreambuf_iterator<char>(in), {});
  }

  // Loads a file of these bytes: refused, or corruption is listed, or the map is whole.
  void ExpectNothingSilentlyWrong(const std::string& bytes, const std::string& what) {
    std::ofstream(path_, std::ios::binary) << bytes;
    const auto loaded = ReadMapFile(path_);
    if (!loaded.ok()) {
      ++refused_;
      EXPECT_FALSE(ErrorText(loaded.status()).empty()) << what;
    } else if (!loaded->corruption.empty()) {
      ++damaged_;
    } else {
      ++intact_;
      SCOPED_TRACE(what);
      ExpectEqual(loaded->set, map_.Layers());
    }
  }

  std::string bytes_;
  int refused_ = 0;
  int damaged_ = 0;
  int intact_ = 0;
};

TEST_F(DamagedMapFileTest, NoFlippedBitGoesUnnoticed) {
  std::mt19937_64 random(1);
  for (int round = 0; round < 200; ++round) {
    std::string bytes = bytes_;
    const size_t place = random() % bytes.size();
    const size_t bit = random() % 8;
    bytes[place] = static_cast<char>(bytes[place] ^ (1 << bit));
    ExpectNothingSilentlyWrong(bytes, fmt::format("bit {} of byte {}", bit, place));
  }
  EXPECT_GT(damaged_, 50);
  EXPECT_GT(intact_, 10);  // places that are not in use
}

TEST_F(DamagedMapFileTest, NoDamagedPageGoesUnnoticed) {
  std::mt19937_64 random(2);
  for (size_t page = 0; page < bytes_.size() / kPage; ++page) {
    for (const size_t length : {size_t{8}, size_t{200}, kPage}) {
      std::string bytes = bytes_;
      for (size_t k = 0; k < length; ++k) bytes[page * kPage + k] = static_cast<char>(random());
      ExpectNothingSilentlyWrong(bytes, fmt::format("{} bytes of page {}", length, page));
      ExpectNothingSilentlyWrong(bytes_.substr(0, page * kPage + length % kPage),
                                 fmt::format("cut within page {}", page));
    }
  }
}

TEST_F(DamagedMapFileTest, AForeignLogBesideTheMapIsNotMixedIn) {
  std::ofstream(path_ + "-wal", std::ios::binary) << std::string(10'000, 'x');
  ExpectNothingSilentlyWrong(bytes_, "text as -wal");
  EXPECT_EQ(intact_, 1);
  // What another map's daemon left when it was killed, the last save in it.
  const std::string other_path = directory_.File("other");
  MapWriter other(map_.options());
  Layer& layer = other.AddLayer({"robot a", 1}, {1, 1});
  auto file = MapFile::Open(other_path);
  for (ControlPoint value = 3; value < 6; ++value) {
    Commit(layer, value);
    ASSERT_TRUE(file->Save(other.Layers()).ok());
  }
  std::filesystem::copy_file(other_path + "-wal", path_ + "-wal",
                             std::filesystem::copy_options::overwrite_existing);
  const auto loaded = ReadMapFile(path_);
  if (loaded.ok() && loaded->corruption.empty()) ExpectEqual(loaded->set, other.Layers());
}

TEST_F(MapFileTest, RowsOfAllSizesAreReadFromPagesAsFromTheDatabase) {
  std::mt19937_64 random(5);
  std::map<int64_t, std::pair<int64_t, std::string>> rows;
  SQLite::Database database(path_, SQLite::OPEN_READWRITE | SQLite::OPEN_CREATE);
  database.exec("PRAGMA journal_mode = WAL; PRAGMA wal_autocheckpoint = 0");
  database.exec("CREATE TABLE t (a INTEGER, b BLOB, c)");
  SQLite::Statement put(database, "INSERT OR REPLACE INTO t (rowid, a, b) VALUES (?, ?, ?)");
  const auto expect_all = [&] {
    std::map<int64_t, std::pair<int64_t, std::string>> found;
    const absl::Status status =
        ForEachRowOfPages(path_, [&](int64_t rowid, absl::Span<const PageColumn> columns) {
          if (columns.size() == 3 && columns[1].is_bytes && !columns[0].is_bytes) {
            found[rowid] = {columns[0].integer, std::string(columns[1].bytes)};
          }
        });
    EXPECT_TRUE(status.ok()) << status;
    EXPECT_EQ(found, rows);
  };
  for (const size_t bytes : {0, 1, 100, 4040, 4050, 4061, 4070, 8000, 8190, 12'300, 900'000}) {
    for (const int64_t a : {int64_t{0}, int64_t{1}, int64_t{-1}, int64_t{-129}, int64_t{40'000},
                            int64_t{-9'000'000}, int64_t{1} << 40, INT64_MIN, INT64_MAX}) {
      const auto rowid = static_cast<int64_t>(random() >> (random() % 60)) / 2;
      std::string blob(bytes, 'x');
      for (char& byte : blob) byte = static_cast<char>(random());
      put.bind(1, rowid);
      put.bind(2, a);
      put.bind(3, blob.data(), static_cast<int>(blob.size()));
      put.exec();
      put.reset();
      rows[rowid] = {a, blob};
    }
    expect_all();
    if (bytes == 4061) database.exec("PRAGMA wal_checkpoint(PASSIVE)");
  }
  {
    SQLite::Transaction transaction(database);  // not committed, partly in the -wal perhaps
    database.exec("PRAGMA cache_size = 10; UPDATE t SET a = 5");
    expect_all();
  }
  database.exec("PRAGMA wal_checkpoint(TRUNCATE)");
  expect_all();
}

// A map like one of a robot that follows others, on enough pages that trees have inner ones.
class DamagedPagesTest : public MapFileTest {
 protected:
  using Rows = std::map<std::tuple<int64_t, int64_t, int64_t>, int64_t>;  // revision by key

  DamagedPagesTest() {
    std::mt19937_64 random(4);
    for (int k = 0; k < 3; ++k) {
      Layer& layer = map_.AddLayer({fmt::format("robot {}", k), random()}, {4, random()});
      if (k == 1) map_.SetOwnLayer(layer.id());
    }
    SettingsTable settings;
    settings.Merge({"gone", 3}, settings.Removal({"gone", 3}, {12, 1}, 79));
    map_.SetSettings(settings);
    auto file = MapFile::Open(path_);
    for (int round = 0; round < 4; ++round) {
      for (size_t k = 0; k < 3; ++k) {
        map_.layer(k).BeginCommit();
        for (int n = 0; n < 30; ++n) {
          map_.layer(k).EditTile(RandomKey(random, 6)) = RandomTile(random, map_.options().limits);
        }
      }
      EXPECT_TRUE(file->Save(map_.Layers()).ok());
    }
    EXPECT_TRUE(file->Close().ok());
    std::ifstream in(path_, std::ios::binary);
    bytes_.assign(std::istreambuf_iterator<char>(in), {});
    original_ = map_.Layers();
    for (size_t page = 0; page < bytes_.size() / kPage; ++page) on_page_.push_back(RowsOf(page));
  }

  // Tiles of one page, as they are found where nothing else is left.
  Rows RowsOf(size_t page) {
    std::string alone(bytes_.size(), '\0');
    alone.replace(page * kPage, kPage, bytes_, page * kPage, kPage);
    Write(alone);
    Rows rows;
    EXPECT_TRUE(ForEachRowOfPages(path_, [&](int64_t, absl::Span<const PageColumn> c) {
                  if (c.size() != 7) return;
                  rows[{c[1].integer, c[2].integer, c[3].integer}] = c[4].integer;
                }).ok());
    return rows;
  }

  void Write(const std::string& bytes) { std::ofstream(path_, std::ios::binary) << bytes; }

  // Reads a file of which these pages are damaged: all tiles of other pages are there, those that
  // are there are as they were, and what is missing is said.
  void ExpectAllButPages(const std::string& bytes, size_t first, size_t last,
                         const std::string& what) {
    SCOPED_TRACE(what);
    Write(bytes);
    const auto loaded = ReadMapFile(path_);
    ASSERT_TRUE(loaded.ok()) << loaded.status();
    size_t on_damaged = 0;
    for (size_t page = first; page < last; ++page) on_damaged += on_page_[page].size();
    size_t expected = 0;
    size_t found = 0;
    ASSERT_EQ(loaded->set.layers.size(), original_.layers.size());
    EXPECT_EQ(loaded->set.options, original_.options);
    EXPECT_EQ(loaded->set.own_layer, original_.own_layer);
    EXPECT_EQ(loaded->set.settings, original_.settings);
    for (size_t k = 0; k < original_.layers.size(); ++k) {
      const LayerSnapshot& layer = loaded->set.layers[k];
      EXPECT_EQ(layer.id, original_.layers[k].id);
      EXPECT_EQ(layer.session, original_.layers[k].session);
      EXPECT_EQ(layer.revision, original_.layers[k].revision);
      const Content content = ContentOf(layer.tiles);
      const Content was = ContentOf(original_.layers[k].tiles);
      for (const auto& [key, tile] : content) {
        const auto before = was.find(key);
        ASSERT_TRUE(before != was.end());
        ASSERT_EQ(tile, before->second);
      }
      expected += was.size();
      found += content.size();
    }
    EXPECT_GE(found + on_damaged, expected);
    EXPECT_TRUE(found == expected || !loaded->corruption.empty());
    expected_ += expected;
    found_ += found;
    ++files_;
    damaged_files_ += loaded->corruption.empty() ? 0 : 1;
  }

  void PrintShare(const char* kind) const {
    fmt::print("{}: {} files of {} pages, {} seen to be damaged, {:.3f} % of tiles read\n", kind,
               files_, on_page_.size(), damaged_files_,
               100.0 * static_cast<double>(found_) / static_cast<double>(expected_));
  }

  std::string bytes_;
  LayerSet original_;
  std::vector<Rows> on_page_;
  size_t expected_ = 0;
  size_t found_ = 0;
  int files_ = 0;
  int damaged_files_ = 0;
};

TEST_F(DamagedPagesTest, AFlippedByteCostsItsRowAtMost) {
  std::mt19937_64 random(6);
  constexpr size_t kVersion = 60;  // of the schema: then the file is of another splinemap
  for (size_t page = 0; page < on_page_.size(); ++page) {
    for (int round = 0; round < 2; ++round) {
      std::string bytes = bytes_;
      // Beginnings of pages say what the rest is.
      const size_t place = page * kPage + (round == 0 ? random() % 12 : random() % kPage);
      if (place >= kVersion && place < kVersion + 4) continue;
      bytes[place] = static_cast<char>(bytes[place] ^ (1 + random() % 255));
      ExpectAllButPages(bytes, page, page + 1, fmt::format("byte {}", place));
    }
  }
  EXPECT_GT(files_, 24);
  PrintShare("flipped bytes");
}

TEST_F(DamagedPagesTest, EveryByteOfTheHeaderButTheVersionMayBeAnything) {
  for (size_t place = 0; place < 108; ++place) {
    if (place >= 60 && place < 64) continue;
    for (const uint8_t value : {uint8_t{0}, uint8_t{1}, uint8_t{0xff}}) {
      std::string bytes = bytes_;
      bytes[place] = static_cast<char>(value);
      ExpectAllButPages(bytes, 0, 1, fmt::format("byte {} is {}", place, value));
    }
  }
  PrintShare("header");
}

TEST_F(DamagedPagesTest, APageOfZerosOrNoiseCostsItsRows) {
  std::mt19937_64 random(7);
  for (size_t page = 0; page < on_page_.size(); ++page) {
    std::string bytes = bytes_;
    bytes.replace(page * kPage, kPage, kPage, '\0');
    ExpectAllButPages(bytes, page, page + 1, fmt::format("zeros in page {}", page));
    for (size_t k = 0; k < kPage; ++k) bytes[page * kPage + k] = static_cast<char>(random());
    ExpectAllButPages(bytes, page, page + 1, fmt::format("noise in page {}", page));
  }
  PrintShare("zeros and noise");
}

TEST_F(DamagedPagesTest, ACutEndCostsWhatWasThere) {
  size_t records_end = 0;  // the pages with the records of the map and of layers
  for (size_t page = 0; page < on_page_.size(); ++page) {
    if (on_page_[page].empty() && page < 8) records_end = page + 1;
  }
  for (int round = 1; round <= 30; ++round) {
    const size_t bytes = records_end * kPage + (bytes_.size() - records_end * kPage) * round / 31;
    ExpectAllButPages(bytes_.substr(0, bytes), bytes / kPage, on_page_.size(),
                      fmt::format("{} bytes of {}", bytes, bytes_.size()));
  }
  EXPECT_EQ(damaged_files_, files_);
  PrintShare("cut ends");
}

TEST_F(DamagedPagesTest, AWriterGoesOnAndKeepsTheFileAsItWas) {
  std::mt19937_64 random(8);
  for (size_t page = 0; page < on_page_.size(); page += 1 + page / 4) {
    SCOPED_TRACE(page);
    std::string bytes = bytes_;
    for (size_t k = 0; k < kPage; ++k) bytes[page * kPage + k] = static_cast<char>(random());
    for (const auto& entry : std::filesystem::directory_iterator(directory_.path())) {
      std::filesystem::remove(entry);
    }
    Write(bytes);
    auto file = MapFile::Open(path_);
    ASSERT_TRUE(file.ok()) << file.status();
    const auto loaded = file->Load();
    ASSERT_TRUE(loaded.ok()) << loaded.status();
    if (loaded->corruption.empty()) continue;  // a page out of use
    const auto saved = file->Save(loaded->set);
    ASSERT_TRUE(saved.ok()) << saved.status();
    const auto kept = ReadMapFile(loaded->kept_copy);
    EXPECT_FALSE(kept->corruption.empty());
    ExpectEqual(kept->set, loaded->set);
    const auto again = ReadMapFile(path_);
    EXPECT_TRUE(again->corruption.empty());
    ExpectEqual(again->set, loaded->set);
  }
}

// The file was killed while it was in use: the last saves are in the -wal alone.
TEST_F(DamagedPagesTest, WhatIsInTheLogBesideIsReadToo) {
  const std::string crashed = directory_.File("crashed");
  {
    Write(bytes_);
    SQLite::Database database(path_, SQLite::OPEN_READWRITE);
    database.exec("PRAGMA journal_mode = WAL; PRAGMA wal_autocheckpoint = 0");
    database.exec("DELETE FROM tile WHERE layer = 3 AND tx = 2");
    for (const char* beside : {"", "-wal"}) {
      std::filesystem::copy_file(path_ + beside, crashed + beside);
    }
  }
  {
    std::fstream file(crashed);
    file << "no database";
  }
  const auto loaded = ReadMapFile(crashed);
  ASSERT_TRUE(loaded.ok()) << loaded.status();
  EXPECT_EQ(ContentOf(loaded->set.layers[0].tiles), ContentOf(original_.layers[0].tiles));
  size_t deleted = 0;
  for (const auto& [key, tile] : ContentOf(original_.layers[2].tiles)) {
    if (key.first == 2) ++deleted;
  }
  EXPECT_GT(deleted, 0u);
  EXPECT_EQ(loaded->set.layers[2].tiles.size(), original_.layers[2].tiles.size() - deleted);
}

// As a disk leaves it that loses what it has synced: all can be read.
TEST_F(DamagedPagesTest, APageInUseThatIsListedAsFreeIsFoundBeforeASaveOverwritesIt) {
  size_t used = 2;
  while (on_page_[used].empty()) ++used;
  std::string bytes = bytes_;
  const auto put = [&](size_t place, size_t value) {
    for (size_t k = 0; k < 4; ++k) bytes[place + k] = static_cast<char>(value >> (24 - 8 * k));
  };
  constexpr size_t kFirstFree = 32;
  put(kFirstFree, used + 1);
  put(kFirstFree + 4, 1);
  Write(bytes);
  auto file = MapFile::Open(path_);
  const auto loaded = file->Load();
  ASSERT_TRUE(loaded.ok()) << loaded.status();
  EXPECT_FALSE(loaded->corruption.empty());
  EXPECT_NE(loaded->kept_copy, "");
  ExpectEqual(loaded->set, original_);
  ASSERT_TRUE(file->Save(loaded->set).ok());
  const auto again = ReadMapFile(path_);
  EXPECT_TRUE(again->corruption.empty());
  ExpectEqual(again->set, original_);
}

// What writes to a page that is damaged already finds out when it saves.
TEST_F(DamagedPagesTest, DamageThatASaveFindsIsMendedFromTheMapInMemory) {
  Write(bytes_);
  auto file = MapFile::Open(path_);
  ASSERT_TRUE(file->Load()->corruption.empty());
  // So that SQLite does not go on with what it has read.
  SQLite::Database(path_, SQLite::OPEN_READWRITE).exec("UPDATE map SET id = 1");
  {
    std::fstream damaged(path_, std::ios::in | std::ios::out | std::ios::binary);
    for (size_t page = 2; page < on_page_.size(); ++page) {
      damaged.seekp(static_cast<std::streamoff>(page * kPage));
      damaged << std::string(100, '\xff');
    }
  }
  std::mt19937_64 random(9);
  map_.layer(0).BeginCommit();
  for (int n = 0; n < 50; ++n) {
    map_.layer(0).EditTile(RandomKey(random, 6)) = RandomTile(random, map_.options().limits);
  }
  const auto problems = file->Save(map_.Layers());
  ASSERT_TRUE(problems.ok()) << problems.status();
  ASSERT_EQ(problems->size(), 1u);
  EXPECT_NE(problems->front().find("was kept as"), std::string::npos) << problems->front();
  const auto again = ReadMapFile(path_);
  EXPECT_TRUE(again->corruption.empty());
  ExpectEqual(again->set, map_.Layers());
}

}  // namespace splinemap::page_scan_test
