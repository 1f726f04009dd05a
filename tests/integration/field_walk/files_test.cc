// Every field of the records of a map file and every column of its tables, to its extremes: records
// with right checksums, so that each value is looked at for itself.
#include <SQLiteCpp/SQLiteCpp.h>
#include <gtest/gtest.h>
#include <spdlog/spdlog.h>
#include <xxhash.h>

#include <atomic>
#include <filesystem>
#include <functional>
#include <set>
#include <thread>

#include "lib/layers/layer_union.h"
#include "lib/store/records.pb.h"
#include "services/splinemapd/daemon.h"
#include "splinemap/file.h"
#include "tests/integration/field_walk/variants.h"
#include "tests/support/extremes.h"
#include "tests/support/map_writer.h"
#include "tests/support/random_map.h"
#include "tests/support/temporary_directory.h"

namespace splinemap::field_walk_files_test {

using google::protobuf::FieldDescriptor;
using google::protobuf::Message;
using google::protobuf::Reflection;

struct Setter {
  std::string field;
  std::string value;
  std::function<void()> set;
};

void AddSetters(Message& record, const std::string& path, std::vector<Setter>& setters);

template <typename Number>
void AddNumbers(Number now, const std::string& path, std::vector<Setter>& setters,
                const std::function<void(Number)>& set) {
  for (const Number value : Extremes(now)) {
    setters.push_back({path, fmt::format("{}", value), [=] { set(value); }});
  }
}

void AddSettersOf(Message& record, const FieldDescriptor& field, const std::string& path,
                  std::vector<Setter>& setters) {
  const Reflection& reflection = *record.GetReflection();
  Message* const message = &record;
  const FieldDescriptor* const what = &field;
  const auto number = [&](auto now, auto set) {
    using Number = decltype(now);
    AddNumbers<Number>(now, path, setters, [&reflection, message, what, set](Number value) {
      (reflection.*set)(message, what, value);
    });
  };
  switch (field.cpp_type()) {
    case FieldDescriptor::CPPTYPE_DOUBLE:
      return number(reflection.GetDouble(record, what), &Reflection::SetDouble);
    case FieldDescriptor::CPPTYPE_INT32:
      return number(reflection.GetInt32(record, what), &Reflection::SetInt32);
    case FieldDescriptor::CPPTYPE_INT64:
      return number(reflection.GetInt64(record, what), &Reflection::SetInt64);
    case FieldDescriptor::CPPTYPE_UINT32:
      return number(reflection.GetUInt32(record, what), &Reflection::SetUInt32);
    case FieldDescriptor::CPPTYPE_UINT64:
      return number(reflection.GetUInt64(record, what), &Reflection::SetUInt64);
    case FieldDescriptor::CPPTYPE_BOOL:
      setters.push_back({path, "turned", [&reflection, message, what] {
                           reflection.SetBool(message, what, !reflection.GetBool(*message, what));
                         }});
      return;
    case FieldDescriptor::CPPTYPE_STRING:
      for (const std::string& value : Extremes(reflection.GetString(record, what))) {
        setters.push_back({path, fmt::format("{} bytes", value.size()),
                           [=, &reflection] { reflection.SetString(message, what, value); }});
      }
      return;
    case FieldDescriptor::CPPTYPE_MESSAGE:
      setters.push_back(
          {path, "absent", [=, &reflection] { reflection.ClearField(message, what); }});
      if (!reflection.HasField(record, what)) {
        setters.back() = {path, "empty",
                          [=, &reflection] { reflection.MutableMessage(message, what); }};
        return;
      }
      return AddSetters(*reflection.MutableMessage(message, what), path + ".", setters);
    default:
      FAIL() << path << " is of a type that the walk does not know";
  }
}

// Of each field: what sets it in `record`, which outlives that. Of repeated ones the first; what
// is absent is made empty.
void AddSetters(Message& record, const std::string& path, std::vector<Setter>& setters) {
  const Reflection& reflection = *record.GetReflection();
  for (int k = 0; k < record.GetDescriptor()->field_count(); ++k) {
    const FieldDescriptor& field = *record.GetDescriptor()->field(k);
    const std::string name = path + std::string(field.name());
    if (!field.is_repeated()) {
      AddSettersOf(record, field, name, setters);
      continue;
    }
    ASSERT_EQ(field.cpp_type(), FieldDescriptor::CPPTYPE_MESSAGE) << name;
    const bool is_empty = reflection.FieldSize(record, &field) == 0;
    if (!is_empty) {
      AddSetters(*reflection.MutableRepeatedMessage(&record, &field, 0), name + "[0].", setters);
    }
    for (const int size : {0, 1, 1024, 1025, 3000}) {
      setters.push_back(
          {name, fmt::format("{} equal elements", size), [&record, &field, size, is_empty] {
             const Reflection& of = *record.GetReflection();
             if (is_empty) of.AddMessage(&record, &field);
             const std::unique_ptr<Message> first(of.GetRepeatedMessage(record, &field, 0).New());
             first->CopyFrom(of.GetRepeatedMessage(record, &field, 0));
             of.ClearField(&record, &field);
             for (int n = 0; n < size; ++n) of.AddMessage(&record, &field)->CopyFrom(*first);
           }});
    }
  }
}

class FileWalkTest : public testing::Test {
 protected:
  FileWalkTest() {
    spdlog::set_level(spdlog::level::off);
    MapWriter map({0.05, {-2560, 2560}});
    std::mt19937_64 random(5);
    SettingsTable settings;
    for (const char* name : {"robot", "other"}) {
      Layer& layer = map.AddLayer({name, random()}, {3, random()});
      for (int n = 0; n < 4; ++n) {
        layer.BeginCommit();
        layer.EditTile(RandomKey(random, 3)) = RandomTile(random, map.options().limits);
      }
      LayerSettings setting = settings.Next(layer.id(), 9);
      setting.low_weight = true;
      settings.Merge(layer.id(), setting);
    }
    map.SetSettings(settings);
    map.SetOwnLayer(map.layers()[0].id());
    original_ = map.Layers();
    auto file = *MapFile::Open(original_path_);
    const auto saved = file.Save(original_);
    EXPECT_TRUE(saved.ok()) << saved.status();
    EXPECT_TRUE(file.Close().ok());
    original_database_ = std::make_unique<SQLite::Database>(original_path_);
  }

  // A copy of the file to be changed.
  SQLite::Database Copy() const {
    std::filesystem::copy_file(original_path_, path_,
                               std::filesystem::copy_options::overwrite_existing);
    SQLite::Database database(path_, SQLite::OPEN_READWRITE);
    database.exec("PRAGMA synchronous = OFF");
    return database;
  }

  // What is wrong with the changed file; empty where it is read, what it lacks is said, the next
  // save mends it, and a daemon goes on with it.
  std::string WhatIsWrong() {
    const auto loaded = ReadMapFile(path_);
    if (!loaded.ok()) return std::string(loaded.status().message());
    if (loaded->corruption.empty() && !HasAllTiles(loaded->set)) return "tiles are gone, unsaid";
    if (!OnlyHasTilesOfTheOriginal(loaded->set)) return "it has wrong tiles";
    auto file = *MapFile::Open(path_);
    const auto again = file.Load();
    if (!again.ok()) return "for writing: " + std::string(again.status().message());
    if (const auto saved = file.Save(again->set); !saved.ok()) {
      return "it cannot be saved: " + std::string(saved.status().message());
    }
    return WhatIsWrongAfterASave(path_);
  }

  static std::string WhatIsWrongAfterASave(const std::string& path) {
    const auto mended = ReadMapFile(path);
    if (!mended.ok()) return "after the next save: " + std::string(mended.status().message());
    return mended->corruption.empty() ? "" : "after the next save: " + mended->corruption[0];
  }

  static std::string WhatADaemonDoesWrong(const std::string& path) {
    config::Config config;
    config.set_name("robot");
    config.set_map(path);
    config.set_pose("POSE");
    config.add_scan()->set_channel("LASER");
    config.mutable_service()->add_follow("*");
    auto daemon = Daemon::Start(config, *LcmBus::Open("memq://"));
    // Knot intervals that daemons do not make.
    if (absl::IsInvalidArgument(daemon.status())) return "";
    if (!daemon.ok()) return "a daemon does not start: " + std::string(daemon.status().message());
    const absl::Status stopped = (*daemon)->Stop();
    if (!stopped.ok()) return "a daemon does not save: " + std::string(stopped.message());
    return WhatIsWrongAfterASave(path);
  }

  // Looks at the changed file, and keeps a copy for a daemon: of all, or of some where time is
  // short.
  void Check(const std::string& change) {
    const bool with_daemon = looked_at_++ % 16 == 0 || PairsOfValues() > 0;
    const ForDaemon copy{directory_.File(fmt::format("{}", looked_at_)), change};
    if (with_daemon) std::filesystem::copy_file(path_, copy.path);
    const std::string wrong = WhatIsWrong();
    EXPECT_EQ(wrong, "") << change;
    if (with_daemon && wrong.empty()) for_daemons_.push_back(copy);
  }

  // Daemons begin with the files that were changed. They wait more than they work.
  void StartDaemons() {
    std::atomic<size_t> next = 0;
    std::vector<std::jthread> threads;
    for (int n = 0; n < 32; ++n) {
      threads.emplace_back([&] {
        for (size_t k; (k = next++) < for_daemons_.size();) {
          EXPECT_EQ(WhatADaemonDoesWrong(for_daemons_[k].path), "") << for_daemons_[k].change;
        }
      });
    }
    threads.clear();
    for_daemons_.clear();
  }

  bool HasAllTiles(const LayerSet& map) const {
    size_t tiles = 0;
    for (const LayerSnapshot& layer : map.layers) tiles += layer.tiles.size();
    size_t all = 0;
    for (const LayerSnapshot& layer : original_.layers) all += layer.tiles.size();
    return tiles == all;
  }

  bool OnlyHasTilesOfTheOriginal(const LayerSet& map) const {
    bool only = true;
    for (const LayerSnapshot& layer : map.layers) {
      layer.tiles.ForEach([&](TileKey key, const TileTree::Entry& entry) {
        only = only && std::any_of(original_.layers.begin(), original_.layers.end(),
                                   [&](const LayerSnapshot& other) {
                                     const StoredTile* tile = other.tiles.Find(key);
                                     return tile != nullptr && HaveEqualContent(*tile, *entry.tile);
                                   });
      });
    }
    return only;
  }

  template <typename Record>
  static std::string Sealed(Record record) {
    record.clear_checksum();
    const std::string bytes = record.SerializeAsString();
    record.set_checksum(XXH3_64bits(bytes.data(), bytes.size()));
    return record.SerializeAsString();
  }

  static constexpr size_t kEveryNth = 5;  // value, the next of a field begins at another one

  template <typename Record>
  void WalkRecord(const std::string& table, int64_t row) {
    const std::string where = fmt::format(" WHERE id = {}", row);
    Record original;
    ASSERT_TRUE(original.ParseFromString(
        original_database_->execAndGet("SELECT record FROM " + table + where).getString()));
    std::set<std::string> fields;
    size_t values = 0;
    for (size_t k = 0;; ++k) {
      Record record = original;
      std::vector<Setter> setters;
      AddSetters(record, "", setters);
      if (k >= setters.size()) break;
      // Each value is a file that is written. By hand, with SPLINEMAP_WALK_PAIRS, all of them.
      if (k % kEveryNth != 0 && PairsOfValues() == 0) continue;
      setters[k].set();
      const bool is_sealed = setters[k].field == "checksum";
      const std::string bytes = is_sealed ? record.SerializeAsString() : Sealed(record);
      SQLite::Database database = Copy();
      SQLite::Statement put(database, "UPDATE " + table + " SET record = ?" + where);
      put.bind(1, bytes.data(), static_cast<int>(bytes.size()));
      put.exec();
      put.reset();
      Check(fmt::format("{} record {}, {} = {}", table, row, setters[k].field, setters[k].value));
      fields.insert(setters[k].field);
      ++values;
    }
    Tally(fmt::format("record {} of {}", row, table)).Add(fields.size(), values);
    StartDaemons();
  }

  struct ForDaemon {
    std::string path;
    std::string change;
  };

  const TemporaryDirectory directory_;
  std::vector<ForDaemon> for_daemons_;
  size_t looked_at_ = 0;
  const std::string original_path_ = directory_.File("original");
  const std::string path_ = directory_.File("robot.splinemap");
  LayerSet original_;
  std::unique_ptr<SQLite::Database> original_database_;
};

TEST_F(FileWalkTest, NoFieldOfTheMapRecordCostsTheFile) { WalkRecord<store::MapRecord>("map", 1); }

TEST_F(FileWalkTest, NoFieldOfARecordOfALayerCostsTheFile) {
  WalkRecord<store::LayerRecord>("layer", 1);
  WalkRecord<store::LayerRecord>("layer", 2);
}

TEST_F(FileWalkTest, NoColumnOfATableCostsTheFile) {
  Tally tally("columns");
  SQLite::Statement columns(*original_database_,
                            "SELECT s.name, c.name, c.type FROM sqlite_schema AS s, "
                            "pragma_table_info(s.name) AS c WHERE s.type = 'table'");
  while (columns.executeStep()) {
    const std::string table = columns.getColumn(0).getString();
    const std::string column = columns.getColumn(1).getString();
    const bool is_number = columns.getColumn(2).getString() == "INTEGER";
    std::set<std::string> taken;
    const size_t values = is_number ? Extremes(int64_t{0}).size() : Extremes(std::string()).size();
    for (size_t k = 0; k < values; ++k) {
      SQLite::Database database = Copy();
      const std::string where = " WHERE rowid = (SELECT min(rowid) FROM " + table + ")";
      const std::string text = is_number
                                   ? fmt::format("{}", Extremes(int64_t{0})[k])
                                   : fmt::format("{} bytes", Extremes(std::string())[k].size());
      SQLite::Statement put(database, "UPDATE " + table + " SET " + column + " = ?" + where);
      if (is_number) {
        put.bind(1, Extremes(int64_t{0})[k]);
      } else if (const std::string value = Extremes(std::string())[k];
                 columns.getColumn(2).getString() == "TEXT") {
        put.bind(1, value);
      } else {
        put.bind(1, value.data(), static_cast<int>(value.size()));
      }
      try {
        put.exec();
      } catch (const SQLite::Exception&) {
        continue;  // not what the column takes
      }
      put.reset();
      taken.insert(column);
      tally.Add(0, 1);
      Check(fmt::format("{}.{} = {}", table, column, text));
    }
    tally.Add(taken.size(), 0);
  }
  StartDaemons();
}

}  // namespace splinemap::field_walk_files_test
