// Rows of a map file, in a database in memory. The input is a program that writes rows: records
// with right checksums and any fields, raw records, tiles with right or raw keys, revisions and
// contents.

#include "lib/store/map_records.h"

#include <SQLiteCpp/SQLiteCpp.h>
#include <xxhash.h>

#include <optional>

#include "lib/map/summed_layers.h"
#include "lib/store/records.pb.h"
#include "lib/tiles/tile_codec.h"
#include "tests/fuzz/fuzz.h"

namespace splinemap::fuzz_map_records {

// Statements on one database, made once.
class Rows {
 public:
  Rows() {
    for (int value = 0; value < 4; ++value) {
      tiles_[value].control_points.fill(static_cast<ControlPoint>(value * 10'000));
      contents_[value] = EncodeTile(tiles_[value]);
    }
  }

  SQLite::Database& database() { return database_; }

  void Write(FuzzInput& input) {
    switch (input.Byte() % 7) {
      case 0:
        return PutMap(MapRecord(input));
      case 1:
        return PutMap(input.Text(input.Byte()));
      case 2:
        return PutLayer(input, LayerRecord(input));
      case 3:
        return PutLayer(input, input.Text(input.Byte()));
      case 4:
        return PutTile(input, input.Byte() % 4);
      case 5:
        return PutSquare(input);
      default:
        return PutTile(input, std::nullopt);
    }
  }

 private:
  template <typename Record>
  static std::string Sealed(Record record) {
    const std::string bytes = record.SerializeAsString();
    record.set_checksum(XXH3_64bits(bytes.data(), bytes.size()));
    return record.SerializeAsString();
  }

  static std::string MapRecord(FuzzInput& input) {
    store::MapRecord record;
    const uint8_t choice = input.Byte();
    record.set_knot_interval_m(choice != 0 ? 0.05 * choice : input.Take<double>());
    record.set_clamp_min(-256 * input.Byte());
    record.set_clamp_max(input.Take<int16_t>());
    record.set_layers(input.Byte());
    return Sealed(record);
  }

  static std::string LayerRecord(FuzzInput& input) {
    store::LayerRecord record;
    record.set_name(Name(input));
    record.set_origin(input.Byte() % 4);
    record.set_revision(input.Byte() != 0 ? 100 : input.Take<uint64_t>());
    record.set_session_number(input.Byte() != 0 ? 1 : input.Take<uint64_t>());
    record.set_row(input.Byte() % 8);
    record.set_tiles(input.Byte() % 8);
    return Sealed(record);
  }

  static std::string Name(FuzzInput& input) {
    const uint8_t choice = input.Byte() % 8;
    return choice < 7 ? std::string(1, static_cast<char>('a' + choice)) : input.Text(3);
  }

  void PutMap(const std::string& record) {
    put_map_.bind(1, record.data(), static_cast<int>(record.size()));
    Run(put_map_);
  }

  void PutLayer(FuzzInput& input, const std::string& record) {
    store::LayerRecord parsed;
    if (input.Byte() % 8 != 0 && parsed.ParseFromString(record)) {
      put_layer_.bind(2, parsed.name());
      put_layer_.bind(3, static_cast<int64_t>(parsed.origin()));
    } else {
      put_layer_.bind(2, Name(input));
      put_layer_.bind(3, input.Take<int64_t>());
    }
    put_layer_.bind(1, input.Byte() % 8);
    put_layer_.bind(4, record.data(), static_cast<int>(record.size()));
    Run(put_layer_);
  }

  void PutTile(FuzzInput& input, std::optional<int> good) {
    const uint8_t choice = input.Byte();
    const int64_t tx = choice != 0 ? choice % 4 : input.Take<int64_t>();
    const int64_t ty = choice != 0 ? choice / 4 % 4 : input.Take<int64_t>();
    const int64_t number = input.Byte() % 8;
    put_tile_.bind(1, number);
    put_tile_.bind(2, input.Byte() % 8);
    put_tile_.bind(3, tx);
    put_tile_.bind(4, ty);
    const int64_t revision = choice % 16 != 1 ? input.Byte() : input.Take<int64_t>();
    put_tile_.bind(5, revision);
    const TileKey key{static_cast<int32_t>(tx), static_cast<int32_t>(ty)};
    const std::string raw = good ? "" : input.Text(input.Byte());
    const std::string& content = good ? contents_[*good] : raw;
    put_tile_.bind(
        6, good ? static_cast<int64_t>(TileChecksum(key, tiles_[*good])) : input.Take<int64_t>());
    put_tile_.bind(7, content.data(), static_cast<int>(content.size()));
    Run(put_tile_);
  }

  // Of tiles with right or raw keys and checksums.
  void PutSquare(FuzzInput& input) {
    const uint8_t choice = input.Byte();
    const int64_t tree = static_cast<int64_t>(input.Byte() % 8) - 2;
    const int64_t x = choice % 8 != 0 ? choice % 2 : input.Take<int64_t>();
    const int64_t y = choice % 16 != 1 ? 0 : input.Take<int64_t>();
    store::SquareRecord record;
    for (int tiles = input.Byte() % 4; tiles > 0; --tiles) {
      const uint8_t child = input.Byte();
      record.add_child(child);
      record.add_number(input.Byte() % 8);
      record.add_revision(input.Byte() != 0 ? 1 : input.Take<uint64_t>());
      const TileKey key{static_cast<int32_t>(8 * static_cast<uint64_t>(x) - 4 + child % 8),
                        static_cast<int32_t>(8 * static_cast<uint64_t>(y) - 4 + child / 8 % 8)};
      record.add_checksum(child < 64 ? TileChecksum(key, tiles_[input.Byte() % 4])
                                     : input.Take<uint64_t>());
      record.add_touched(input.Take<uint32_t>());
    }
    if (choice % 32 == 2) record.add_number(1);
    const std::string content = record.SerializeAsString();
    put_square_.bind(1, tree);
    put_square_.bind(2, x);
    put_square_.bind(3, y);
    put_square_.bind(4, content.data(), static_cast<int>(content.size()));
    put_square_.bind(5, choice % 32 == 3
                            ? input.Take<int64_t>()
                            : static_cast<int64_t>(ChecksumOfSquare(tree, x, y, content)));
    Run(put_square_);
  }

  static void Run(SQLite::Statement& statement) {
    statement.exec();
    statement.reset();
  }

  static SQLite::Database NewDatabase() {
    SQLite::Database database(":memory:", SQLite::OPEN_READWRITE);
    MakeSchema(database);
    return database;
  }

  SQLite::Database database_ = NewDatabase();
  Tile tiles_[4];
  std::string contents_[4];
  SQLite::Statement put_map_{database_, "INSERT OR REPLACE INTO map VALUES (1, ?)"};
  SQLite::Statement put_layer_{database_, "INSERT OR REPLACE INTO layer VALUES (?, ?, ?, ?)"};
  SQLite::Statement put_square_{database_,
                                "INSERT OR REPLACE INTO tile_square VALUES (?, ?, ?, ?, ?)"};
  SQLite::Statement put_tile_{database_,
                              "INSERT OR REPLACE INTO tile VALUES (?, ?, ?, ?, ?, ?, ?)"};
};

bool AreEqual(const LayerSet& a, const LayerSet& b) {
  const auto sum_a = ViewOf(a);
  const auto sum_b = ViewOf(b);
  bool equal = a.options == b.options && a.layers.size() == b.layers.size() &&
               sum_a->tiles.size() == sum_b->tiles.size();
  sum_a->tiles.ForEach([&](TileKey key, const TileTree::Entry& entry) {
    const StoredTile* other = sum_b->tiles.Find(key);
    equal = equal && other != nullptr && HaveEqualContent(*other, *entry.tile);
  });
  return equal;
}

void Run(FuzzInput input) {
  static Rows rows;
  SQLite::Transaction transaction(rows.database());  // rolled back
  while (!input.empty()) rows.Write(input);
  const auto no_rows = [](ControlLimits) { return nullptr; };
  const absl::StatusOr<ReadRows> loaded = ReadMap("fuzz", rows.database(), no_rows);
  if (!loaded.ok()) return;
  const LayerSet& set = loaded->map.set;
  ViewOf(set)->Evaluate(0.1, 0.1);
  RemakeTables(rows.database());
  MapRowWriter writer(std::make_shared<TileRows>("", set.options.limits, nullptr), rows.database());
  std::vector<std::string> problems;
  writer.Write(set, {}, problems);
  Require(problems.empty(), "what was read can be written");
  writer.Finish();
  const absl::StatusOr<ReadRows> again = ReadMap("fuzz", rows.database(), no_rows);
  Require(again.ok(), "a map that was read can be written and read");
  Require(again->map.corruption.empty(), "a save mends a damaged map");
  Require(AreEqual(set, again->map.set), "a map that was read is written the same");
}

const FuzzTarget target("map_records", &Run);

}  // namespace splinemap::fuzz_map_records
