#include "lib/store/map_records.h"

#include <SQLiteCpp/SQLiteCpp.h>
#include <xxhash.h>

#include <algorithm>
#include <array>
#include <chrono>
#include <cmath>
#include <limits>
#include <map>
#include <optional>

#include "lib/base/host_clock.h"
#include "lib/base/status.h"
#include "lib/map/tile_update.h"
#include "lib/store/records.pb.h"

namespace splinemap {
namespace {

constexpr int kApplicationId = 0x53504c4d;  // "SPLM"
constexpr int kSchemaVersion = 2;

constexpr const char* kSchema = R"(
  CREATE TABLE map (
    id INTEGER PRIMARY KEY CHECK (id = 1),
    record BLOB NOT NULL
  ) STRICT;
  CREATE TABLE layer (
    id INTEGER PRIMARY KEY,
    name TEXT NOT NULL,
    origin INTEGER NOT NULL,
    record BLOB NOT NULL,
    UNIQUE (name, origin)
  ) STRICT;
  CREATE TABLE tile (
    layer INTEGER NOT NULL REFERENCES layer (id),
    tx INTEGER NOT NULL,
    ty INTEGER NOT NULL,
    revision INTEGER NOT NULL,
    checksum INTEGER NOT NULL,
    content BLOB NOT NULL,
    PRIMARY KEY (layer, tx, ty)
  ) STRICT;
)";

// SQLite's integers are signed.
int64_t ToSql(uint64_t value) { return static_cast<int64_t>(value); }
uint64_t FromSql(int64_t value) { return static_cast<uint64_t>(value); }

std::vector<std::string> Tables(SQLite::Database& database) {
  SQLite::Statement query(database, "SELECT coalesce(sql, name) FROM sqlite_schema ORDER BY name");
  std::vector<std::string> tables;
  while (query.executeStep()) tables.push_back(query.getColumn(0).getString());
  return tables;
}

store::LayerName ToRecord(const LayerId& id) {
  store::LayerName record;
  record.set_name(id.name);
  record.set_origin(id.origin);
  return record;
}

LayerId FromRecord(const store::LayerName& record) { return {record.name(), record.origin()}; }

store::ControlRecord ToRecord(const LayerId& id, const LayerControl& control) {
  store::ControlRecord record;
  *record.mutable_layer() = ToRecord(id);
  record.set_muted(control.muted);
  record.set_yields(control.yields);
  record.set_shift_i(control.shift.i);
  record.set_shift_j(control.shift.j);
  record.set_x_m(control.alignment[0]);
  record.set_y_m(control.alignment[1]);
  record.set_yaw_rad(control.alignment[2]);
  record.set_counter(control.counter);
  record.set_writer(control.writer);
  record.set_removed_up_to(control.removed_up_to);
  return record;
}

LayerControl FromRecord(const store::ControlRecord& record) {
  return {.muted = record.muted(),
          .yields = record.yields(),
          .shift = {record.shift_i(), record.shift_j()},
          .alignment = {record.x_m(), record.y_m(), record.yaw_rad()},
          .counter = record.counter(),
          .writer = record.writer(),
          .removed_up_to = record.removed_up_to()};
}

bool IsPlausible(const store::MapRecord& record) {
  constexpr int kMin = std::numeric_limits<ControlPoint>::min();
  constexpr int kMax = std::numeric_limits<ControlPoint>::max();
  return record.knot_interval_m() > 0 && std::isfinite(record.knot_interval_m()) &&
         record.clamp_min() >= kMin && record.clamp_min() < 0 && record.clamp_max() > 0 &&
         record.clamp_max() <= kMax &&
         std::all_of(
             record.controls().begin(), record.controls().end(),
             [](const store::ControlRecord& control) { return FromRecord(control).IsValid(); });
}

bool IsPlausible(const store::LayerRecord& record) {
  constexpr uint64_t kMax = uint64_t{1} << 62;  // leaves room to count on
  return record.incarnation() < kMax && record.revision() < kMax;
}

template <typename Record>
uint64_t ChecksumOf(Record record) {
  record.clear_checksum();
  const std::string bytes = record.SerializeAsString();
  return XXH3_64bits(bytes.data(), bytes.size());
}

template <typename Record>
std::string BytesOf(Record record) {
  record.set_checksum(ChecksumOf(record));
  return record.SerializeAsString();
}

template <typename Record>
std::optional<Record> RecordOf(const std::string& bytes) {
  Record record;
  if (!record.ParseFromString(bytes) || record.checksum() != ChecksumOf(record) ||
      !IsPlausible(record)) {
    return std::nullopt;
  }
  return record;
}

// Whether a tile is there at its revision, as a sum over all of a layer in any order. The content
// has its own checksum.
struct TileTally {
  uint64_t tiles = 0;
  uint64_t digest = 0;

  void Add(TileKey key, uint64_t revision) {
    const std::array<uint64_t, 3> row{FromSql(key.tx), FromSql(key.ty), revision};
    ++tiles;
    digest += XXH3_64bits(row.data(), sizeof row);
  }
  bool operator==(const TileTally&) const = default;
};

TileTally TallyOf(const TileTree& tree) {
  TileTally tally;
  tree.ForEach([&](TileKey key, const TileTree::Entry& entry) { tally.Add(key, entry.revision); });
  return tally;
}

std::optional<TileKey> KeyOf(int64_t tx, int64_t ty) {
  const TileKey key{static_cast<int32_t>(tx), static_cast<int32_t>(ty)};
  if (key.tx != tx || key.ty != ty || !IsInRange(key)) return std::nullopt;
  return key;
}

bool IsWithin(const Tile& tile, ControlLimits limits) {
  const auto [least, greatest] =
      std::minmax_element(tile.control_points.begin(), tile.control_points.end());
  return *least >= limits.min && *greatest <= limits.max;
}

// The tile of a row tx, ty, revision, checksum, content.
absl::StatusOr<Tile> TileOfRow(SQLite::Statement& row, TileKey key, ControlLimits limits) {
  SPLINEMAP_ASSIGN_OR_RETURN(
      const Tile tile,
      TileOfUpdate({key, FromSql(row.getColumn(2).getInt64()), row.getColumn(4).getString(),
                    FromSql(row.getColumn(3).getInt64())}));
  if (!IsWithin(tile, limits)) {
    return DataLoss("tile ({}, {}) has control points beyond the clamps", key.tx, key.ty);
  }
  return tile;
}

// Restores the tiles of the row `layer_row`; returns what is damaged.
std::vector<std::string> ReadTiles(SQLite::Database& database, int64_t layer_row,
                                   const store::LayerRecord& record, ControlLimits limits,
                                   Layer& layer) {
  SQLite::Statement rows(database,
                         "SELECT tx, ty, revision, checksum, content FROM tile WHERE layer = ?");
  rows.bind(1, layer_row);
  std::vector<std::string> damages;
  TileTally tally;
  while (rows.executeStep()) {
    const int64_t tx = rows.getColumn(0).getInt64();
    const int64_t ty = rows.getColumn(1).getInt64();
    const uint64_t revision = FromSql(rows.getColumn(2).getInt64());
    const std::optional<TileKey> key = KeyOf(tx, ty);
    if (!key || revision == 0 || revision > record.revision()) {
      damages.push_back(fmt::format("tile ({}, {}) of revision {} cannot be", tx, ty, revision));
      continue;
    }
    tally.Add(*key, revision);
    if (const absl::StatusOr<Tile> tile = TileOfRow(rows, *key, limits); tile.ok()) {
      layer.RestoreTile(*key, std::make_shared<const Tile>(*tile), revision);
    } else {
      damages.push_back(ErrorText(tile.status()));
    }
  }
  if (tally != TileTally{record.tiles(), record.tiles_digest()}) {
    damages.push_back(
        fmt::format("the tiles are not those that were saved: {} in place of {}, or "
                    "other revisions",
                    tally.tiles, record.tiles()));
  }
  return damages;
}

// Writes the record; returns the number of the layer's row.
int64_t WriteLayer(const LayerSnapshot& layer, SQLite::Database& database) {
  const TileTally tally = TallyOf(layer.tiles);
  store::LayerRecord record;
  record.set_name(layer.id.name);
  record.set_origin(layer.id.origin);
  record.set_incarnation(layer.epoch.incarnation);
  record.set_nonce(layer.epoch.nonce);
  record.set_revision(layer.revision);
  record.set_saved_utime(HostUtime());
  record.set_tiles(tally.tiles);
  record.set_tiles_digest(tally.digest);
  const std::string bytes = BytesOf(record);
  SQLite::Statement put(database,
                        "INSERT INTO layer (name, origin, record) VALUES (?, ?, ?) "
                        "ON CONFLICT (name, origin) DO UPDATE SET record = excluded.record "
                        "RETURNING id");
  put.bind(1, layer.id.name);
  put.bind(2, ToSql(layer.id.origin));
  put.bind(3, bytes.data(), static_cast<int>(bytes.size()));
  put.executeStep();
  const int64_t id = put.getColumn(0).getInt64();
  while (put.executeStep()) {
  }
  return id;
}

void WriteTiles(const LayerSnapshot& layer, int64_t layer_row, uint64_t since,
                SQLite::Database& database) {
  SQLite::Statement put(database,
                        "INSERT OR REPLACE INTO tile (layer, tx, ty, revision, checksum, content) "
                        "VALUES (?, ?, ?, ?, ?, ?)");
  put.bind(1, layer_row);
  layer.tiles.ForEachChanged(since, [&](TileKey key, const TileTree::Entry& entry) {
    const TileUpdate update = MakeTileUpdate(key, *entry.tile, entry.revision);
    put.bind(2, update.key.tx);
    put.bind(3, update.key.ty);
    put.bind(4, ToSql(update.revision));
    put.bind(5, ToSql(update.checksum));
    put.bind(6, update.content.data(), static_cast<int>(update.content.size()));
    put.exec();
    put.reset();
  });
}

// Deletes the tiles of layers that do not go on, and the rows of those that are not in the map.
void DeleteOld(const MapSnapshot& map, const std::map<LayerId, uint64_t>& going_on,
               SQLite::Database& database) {
  std::vector<int64_t> begun_anew;
  std::vector<int64_t> gone;
  SQLite::Statement layers(database, "SELECT id, name, origin FROM layer");
  while (layers.executeStep()) {
    const LayerId id{layers.getColumn(1).getString(), FromSql(layers.getColumn(2).getInt64())};
    if (going_on.contains(id)) continue;
    const int64_t row = layers.getColumn(0).getInt64();
    begun_anew.push_back(row);
    if (std::none_of(map.layers.begin(), map.layers.end(),
                     [&](const LayerSnapshot& layer) { return layer.id == id; })) {
      gone.push_back(row);
    }
  }
  const auto run = [&](const char* sql, const std::vector<int64_t>& rows) {
    SQLite::Statement statement(database, sql);
    for (const int64_t row : rows) {
      statement.bind(1, row);
      statement.exec();
      statement.reset();
    }
  };
  run("DELETE FROM tile WHERE layer = ?", begun_anew);
  run("DELETE FROM layer WHERE id = ?", gone);
}

}  // namespace

bool SavedLayer::GoesOnAs(const LayerSnapshot& layer) const {
  return layer.id == id && (tree_line == 0 || layer.tiles.line() == tree_line) &&
         layer.tiles.size() >= num_tiles;
}

std::vector<SavedLayer> SavedLayersOf(const MapSnapshot& map) {
  std::vector<SavedLayer> saved;
  for (const LayerSnapshot& layer : map.layers) {
    saved.push_back({layer.id, layer.tiles.epoch(), layer.tiles.line(), layer.tiles.size()});
  }
  return saved;
}

bool IsUnused(SQLite::Database& database) {
  return database.execAndGet("SELECT count(*) FROM sqlite_schema").getInt() == 0 &&
         database.execAndGet("PRAGMA application_id").getInt() == 0;
}

void MakeSchema(SQLite::Database& database) {
  SQLite::Transaction transaction(database);
  database.exec(kSchema);
  database.exec(fmt::format("PRAGMA application_id = {}", kApplicationId));
  database.exec(fmt::format("PRAGMA user_version = {}", kSchemaVersion));
  transaction.commit();
}

absl::Status CheckSchema(const std::string& path, SQLite::Database& database) {
  if (database.execAndGet("PRAGMA application_id").getInt() != kApplicationId) {
    return InvalidArgument("{} is no map file: it is a database of another program", path);
  }
  const int version = database.execAndGet("PRAGMA user_version").getInt();
  if (version != kSchemaVersion) {
    return FailedPrecondition("{} has schema {} and was made by {} splinemap; this one knows {}",
                              path, version, version > kSchemaVersion ? "a newer" : "an older",
                              kSchemaVersion);
  }
  SQLite::Database expected(":memory:", SQLite::OPEN_READWRITE);
  MakeSchema(expected);
  if (Tables(database) != Tables(expected)) {
    return InvalidArgument("{} is no map file: its tables are not those of a map", path);
  }
  return absl::OkStatus();
}

bool HasMap(SQLite::Database& database) {
  return database.execAndGet("SELECT count(*) FROM map").getInt() > 0;
}

absl::StatusOr<LoadedMap> ReadMap(const std::string& path, SQLite::Database& database) {
  SQLite::Statement map_row(database, "SELECT record FROM map");
  if (!map_row.executeStep()) return NotFound("{} holds no map yet", path);
  const auto map_record = RecordOf<store::MapRecord>(map_row.getColumn(0).getString());
  if (!map_record) return DataLoss("{} is damaged: its map record cannot be read", path);
  const ControlLimits limits{static_cast<ControlPoint>(map_record->clamp_min()),
                             static_cast<ControlPoint>(map_record->clamp_max())};
  Map map({map_record->knot_interval_m(), limits});
  LoadedMap loaded;
  SQLite::Statement layers(database, "SELECT id, name, origin, record FROM layer ORDER BY id");
  while (layers.executeStep()) {
    const auto record = RecordOf<store::LayerRecord>(layers.getColumn(3).getString());
    if (!record || record->name() != layers.getColumn(1).getString() ||
        record->origin() != FromSql(layers.getColumn(2).getInt64())) {
      return DataLoss("{} is damaged: the record of a layer cannot be read", path);
    }
    const LayerId id{record->name(), record->origin()};
    if (std::any_of(map.layers().begin(), map.layers().end(),
                    [&](const Layer& layer) { return layer.id() == id; })) {
      return DataLoss("{} is damaged: layer {} is there twice", path, id.name);
    }
    Layer& layer = map.AddLayer(id, {record->incarnation(), record->nonce()});
    layer.RestoreRevision(record->revision());
    for (const std::string& damage :
         ReadTiles(database, layers.getColumn(0).getInt64(), *record, limits, layer)) {
      loaded.damages.push_back(fmt::format("{}: layer {}: {}", path, id.name, damage));
    }
  }
  if (map.layers().size() != map_record->layers()) {
    loaded.damages.push_back(fmt::format("{}: {} layers in place of {}", path, map.layers().size(),
                                         map_record->layers()));
  }
  if (map_record->has_own_layer()) map.SetOwnLayer(FromRecord(map_record->own_layer()));
  LayerControls controls;
  for (const store::ControlRecord& control : map_record->controls()) {
    controls.Take(FromRecord(control.layer()), FromRecord(control));
  }
  map.SetControls(std::move(controls));
  loaded.map = map.Snapshot();
  return loaded;
}

void WriteMap(const MapSnapshot& map, const std::vector<SavedLayer>& saved,
              SQLite::Database& database) {
  std::map<LayerId, uint64_t> written;  // layers that go on, and the epoch of the tree in the rows
  for (const LayerSnapshot& layer : map.layers) {
    for (const SavedLayer& known : saved) {
      if (known.GoesOnAs(layer)) written.emplace(layer.id, known.tree_epoch);
    }
  }
  DeleteOld(map, written, database);
  store::MapRecord record;
  record.set_knot_interval_m(map.options.knot_interval_m);
  record.set_clamp_min(map.options.limits.min);
  record.set_clamp_max(map.options.limits.max);
  record.set_layers(static_cast<uint32_t>(map.layers.size()));
  if (map.own_layer) *record.mutable_own_layer() = ToRecord(*map.own_layer);
  for (const auto& [id, control] : map.controls.records()) {
    *record.add_controls() = ToRecord(id, control);
  }
  const std::string bytes = BytesOf(record);
  SQLite::Statement put_map(database, "INSERT OR REPLACE INTO map (id, record) VALUES (1, ?)");
  put_map.bind(1, bytes.data(), static_cast<int>(bytes.size()));
  put_map.exec();
  for (const LayerSnapshot& layer : map.layers) {
    const int64_t row = WriteLayer(layer, database);
    const auto known = written.find(layer.id);
    WriteTiles(layer, row, known == written.end() ? 0 : known->second, database);
  }
}

}  // namespace splinemap
