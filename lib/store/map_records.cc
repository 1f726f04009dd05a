#include "lib/store/map_records.h"

#include <SQLiteCpp/SQLiteCpp.h>
#include <xxhash.h>

#include <algorithm>
#include <array>
#include <chrono>
#include <deque>
#include <limits>
#include <map>
#include <memory>
#include <optional>
#include <set>
#include <string_view>
#include <utility>

#include "absl/strings/escaping.h"
#include "lib/base/host_clock.h"
#include "lib/base/status.h"
#include "lib/layers/validity.h"
#include "lib/store/page_scan.h"
#include "lib/store/records.pb.h"
#include "lib/tiles/tile_codec.h"

namespace splinemap {
namespace {

constexpr int kApplicationId = 0x53504c4d;  // "SPLM"
constexpr int kSchemaVersion = 5;        // 4 has other blocks of scans, which are read
constexpr int kArchiveVersion = 4;       // from which on there are archives
constexpr int kOldestSchemaVersion = 2;  // whose rows and records say less

// From here on the record of the map has no more copies of those of layers: rows are bounded.
constexpr size_t kMaxCopiesBytes = 512 * 1024;

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

int VersionOf(SQLite::Database& database) {
  return database.execAndGet("PRAGMA user_version").getInt();
}

std::vector<std::string> Tables(SQLite::Database& database) {
  SQLite::Statement query(database, "SELECT coalesce(sql, name) FROM sqlite_schema ORDER BY name");
  std::vector<std::string> tables;
  while (query.executeStep()) tables.push_back(query.getColumn(0).getString());
  return tables;
}

// Names are any bytes.
std::string Shown(const std::string& name) { return absl::Utf8SafeCHexEscape(name.substr(0, 64)); }

// Whether some of the tables are ours, but for bytes that differ: what is left on a damaged page.
bool IsLike(const std::vector<std::string>& tables, std::vector<std::string> our_tables) {
  for (const std::string& table : tables) {
    const auto like =
        std::find_if(our_tables.begin(), our_tables.end(),
                     [&](const std::string& ours) { return ours.size() == table.size(); });
    if (like == our_tables.end()) return false;
    our_tables.erase(like);
  }
  return true;
}

store::LayerName ToRecord(const LayerId& id) {
  store::LayerName record;
  record.set_name(id.name);
  record.set_origin(id.origin);
  return record;
}

LayerId FromRecord(const store::LayerName& record) { return {record.name(), record.origin()}; }

store::SettingsRecord ToRecord(const LayerId& id, const LayerSettings& setting) {
  store::SettingsRecord record;
  *record.mutable_layer() = ToRecord(id);
  record.set_muted(setting.muted);
  record.set_low_weight(setting.low_weight);
  record.set_placement_x(setting.placement.x);
  record.set_placement_y(setting.placement.y);
  record.set_placement_yaw(setting.placement.yaw);
  record.set_counter(setting.counter);
  record.set_writer(setting.writer);
  record.set_removed_up_to(setting.removed_up_to);
  return record;
}

// What cannot be is no valid placement.
FixedPose2 PlacementOf(const store::SettingsRecord& record, double knot_interval_m) {
  if (record.shift_i() == 0 && record.shift_j() == 0) {
    return {record.placement_x(), record.placement_y(), record.placement_yaw()};
  }
  const Pose2 pose{{record.shift_i() * knot_interval_m, record.shift_j() * knot_interval_m}, 0};
  return FixedPose2::IsInRange(pose) ? FixedPose2::Nearest(pose)
                                     : FixedPose2{.x = FixedPose2::kMaxUnits + 1};
}

LayerSettings FromRecord(const store::SettingsRecord& record, double knot_interval_m) {
  return {.muted = record.muted(),
          .low_weight = record.low_weight(),
          .placement = PlacementOf(record, knot_interval_m),
          .counter = record.counter(),
          .writer = record.writer(),
          .removed_up_to = record.removed_up_to()};
}

std::optional<MapOptions> OptionsOf(const store::MapRecord& record) {
  const MapOptions options{record.knot_interval_m(),
                           {static_cast<ControlPoint>(record.clamp_min()),
                            static_cast<ControlPoint>(record.clamp_max())}};
  if (options.limits.min != record.clamp_min() || options.limits.max != record.clamp_max() ||
      !CheckMapOptions(options).ok()) {
    return std::nullopt;
  }
  return options;
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
  if (!record.ParseFromString(bytes) || record.checksum() != ChecksumOf(record)) {
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

std::optional<TileKey> KeyOf(int64_t tx, int64_t ty) {
  const TileKey key{static_cast<int32_t>(tx), static_cast<int32_t>(ty)};
  if (key.tx != tx || key.ty != ty || !IsInRange(key)) return std::nullopt;
  return key;
}

// The columns of the tables, which tell in a page what a row is of: i for integer, b for bytes.
constexpr std::string_view kMapForm = "ib";
constexpr std::string_view kLayerForm = "ibib";
constexpr std::string_view kTileForm = "iiiiib";

bool HasForm(absl::Span<const PageColumn> columns, std::string_view form) {
  return std::equal(
      columns.begin(), columns.end(), form.begin(), form.end(),
      [](const PageColumn& column, char kind) { return column.is_bytes == (kind == 'b'); });
}

// What `checksum` of a row says: that of the tile, bound to the layer and the revision as well, so
// that no row of a damaged page is taken for another's. In files of schema 2 it is the tile's
// alone.
uint64_t ChecksumOfRow(uint64_t tile_checksum, int64_t layer_row, uint64_t revision) {
  const std::array<uint64_t, 2> row{FromSql(layer_row), revision};
  return XXH3_64bits_withSeed(row.data(), sizeof row, tile_checksum);
}

struct TileRow {
  int64_t layer = 0;
  int64_t tx = 0;
  int64_t ty = 0;
  uint64_t revision = 0;
  uint64_t checksum = 0;
  std::string content;
};

absl::StatusOr<Tile> TileOfRow(const TileRow& row, TileKey key, ControlLimits limits) {
  SPLINEMAP_ASSIGN_OR_RETURN(const Tile tile, DecodeTile(row.content));
  const uint64_t checksum = TileChecksum(key, tile);
  if (row.checksum != ChecksumOfRow(checksum, row.layer, row.revision) &&
      row.checksum != checksum) {
    return DataLoss("tile ({}, {}) does not match its checksum", key.tx, key.ty);
  }
  SPLINEMAP_RETURN_IF_ERROR(CheckTile(key, tile, limits));
  return tile;
}

// Puts a map together from rows: first those of the tables map and layer, then those of tiles.
class MapReader {
 public:
  explicit MapReader(std::string path) : path_(std::move(path)) {}

  void ReadMapRow(const std::string& bytes) {
    has_rows_ = true;
    const auto record = RecordOf<store::MapRecord>(bytes);
    if (record && OptionsOf(*record)) map_record_ = *record;
  }

  void ReadLayerRow(int64_t row, const std::string& bytes) {
    has_rows_ = true;
    const auto record = RecordOf<store::LayerRecord>(bytes);
    if (!record) return Damage("the record of a layer cannot be read");
    if (record->has_map() && OptionsOf(record->map())) map_copy_ = record->map();
    if (record->row() != 0 && record->row() != row) {
      Damage(fmt::format("layer {} stands in row {} in place of {}", Shown(record->name()), row,
                         record->row()));
    }
    records_.insert_or_assign(record->row() != 0 ? record->row() : row, *record);
  }

  void NoteTiles() { has_rows_ = true; }

  // NotFound where there was no row; DataLoss where no record says what the map's options are.
  absl::Status BeginTiles() {
    if (!has_rows_) return NotFound("{} holds no map yet", path_);
    if (!map_record_ && map_copy_) {
      Damage("the record of the map cannot be read; its copy is used");
      map_record_ = map_copy_;
    }
    if (!map_record_)
      return DataLoss("{} is damaged: no record of its knot interval is left", path_);
    set_.options = *OptionsOf(*map_record_);
    archives_.emplace(set_.options.limits);
    for (const store::LayerRecord& copy : map_record_->layer()) {
      if (records_.try_emplace(copy.row(), copy).second) {
        Damage(fmt::format("the record of layer {} cannot be read; its copy is used",
                           Shown(copy.name())));
      }
      AddLayer(copy.row(), records_.at(copy.row()));  // in the order of the map that was saved
    }
    for (const auto& [row, record] : records_) AddLayer(row, record);
    return absl::OkStatus();
  }

  std::vector<int64_t> LayerRows() const {
    std::vector<int64_t> rows;
    for (const auto& [row, reading] : layers_) rows.push_back(row);
    return rows;
  }

  void HandleTile(const TileRow& row) {
    const auto found = layers_.find(row.layer);
    if (found == layers_.end()) return;  // of a layer that is gone; WriteMap() deletes them
    Reading& reading = found->second;
    const std::optional<TileKey> key = KeyOf(row.tx, row.ty);
    if (!key || row.revision == 0 || row.revision > reading.max_revision) {
      DamageOf(reading,
               fmt::format("tile ({}, {}) of revision {} cannot be", row.tx, row.ty, row.revision));
      return;
    }
    reading.tally.Add(*key, row.revision);
    if (const auto tile = TileOfRow(row, *key, set_.options.limits); tile.ok()) {
      reading.layer->RestoreTile(*key, std::make_shared<const Tile>(*tile), row.revision);
    } else {
      DamageOf(reading, ErrorText(tile.status()));
    }
  }

  // Valid after BeginTiles().
  ArchiveReader& archives() { return *archives_; }
  // Valid after Finish().
  const SavedArchives& saved_archives() const { return saved_archives_; }

  LoadedMap Finish() {
    std::map<LayerId, std::shared_ptr<const ScanArchive>> archives;
    for (const auto& [row, reading] : layers_) {
      const store::LayerRecord& record = records_.at(row);
      const ArchiveReader::Result result = archives_->Finish(
          record.has_archive() ? &record.archive() : nullptr, reading.layer->Snapshot().tiles);
      for (const std::string& damage : result.damage) DamageOf(reading, damage);
      archives[reading.layer->id()] = result.archive;
      saved_archives_[reading.layer->id()] = result.saved;
      if (reading.tally == TileTally{record.tiles(), record.tiles_digest()}) continue;
      DamageOf(reading, fmt::format("the tiles are not those that were saved: {} in place of {}, "
                                    "or other revisions",
                                    reading.tally.tiles, record.tiles()));
    }
    if (read_.size() != map_record_->layers()) {
      Damage(fmt::format("{} layers in place of {}", read_.size(), map_record_->layers()));
    }
    if (map_record_->has_own_layer()) {
      const LayerId own = FromRecord(map_record_->own_layer());
      if (const absl::Status status = CheckLayerId(own); status.ok()) {
        set_.own_layer = own;
      } else {
        Damage("the layer that goes on here cannot be: " + ErrorText(status));
      }
    }
    SettingsTable settings;
    for (const store::SettingsRecord& record : map_record_->settings()) {
      const LayerId id = FromRecord(record.layer());
      const LayerSettings setting = FromRecord(record, set_.options.knot_interval_m);
      if (CheckLayerId(id).ok() && setting.IsValid() &&
          (settings.Merge(id, setting) || settings.Of(id) == setting)) {
        continue;
      }
      Damage(fmt::format("a setting about layer {} cannot be", Shown(id.name)));
    }
    set_.settings = std::move(settings);
    for (Layer& layer : read_) {
      set_.layers.push_back(layer.Snapshot());
      set_.layers.back().archive = archives.at(layer.id());
    }
    return {std::move(set_), std::move(corruption_), {}};
  }

 private:
  struct Reading {
    Layer* layer = nullptr;
    uint64_t max_revision = 0;  // that a tile may have
    TileTally tally;
  };

  void Damage(const std::string& damage) {
    corruption_.push_back(fmt::format("{}: {}", path_, damage));
  }
  void DamageOf(const Reading& reading, const std::string& damage) {
    Damage(fmt::format("layer {}: {}", Shown(reading.layer->id().name), damage));
  }

  // What cannot be of a layer's record is as if it were not known: any start of its owner is newer
  // then, and the commits are those of its tiles.
  void AddLayer(int64_t row, const store::LayerRecord& record) {
    if (layers_.contains(row)) return;
    const LayerId id{record.name(), record.origin()};
    const bool is_twice = std::any_of(read_.begin(), read_.end(),
                                      [&](const Layer& layer) { return layer.id() == id; });
    if (const absl::Status status = CheckLayerId(id); !status.ok() || is_twice) {
      Damage(is_twice ? fmt::format("layer {} is there twice", Shown(id.name))
                      : "a layer cannot be: " + ErrorText(status));
      return;
    }
    SessionId session{record.session_number(), record.nonce()};
    const absl::Status session_status = CheckSessionId(session);
    if (!session_status.ok()) session = {};
    const absl::Status revision_status = CheckRevision(record.revision());
    Layer& layer = read_.emplace_back(id, session);
    if (revision_status.ok()) layer.RestoreRevision(record.revision());
    const Reading& reading =
        layers_[row] = {&layer, revision_status.ok() ? record.revision() : kMaxRevision, {}};
    for (const absl::Status& status : {session_status, revision_status}) {
      if (!status.ok()) DamageOf(reading, ErrorText(status));
    }
  }

  const std::string path_;
  bool has_rows_ = false;
  std::optional<store::MapRecord> map_record_;
  std::optional<store::MapRecord> map_copy_;
  std::map<int64_t, store::LayerRecord> records_;  // by the layer's id in the tables
  LayerSet set_;
  std::deque<Layer> read_;
  std::map<int64_t, Reading> layers_;
  std::optional<ArchiveReader> archives_;
  SavedArchives saved_archives_;
  std::vector<std::string> corruption_;
};

store::MapRecord MapRecordOf(const LayerSet& map, size_t layers,
                             std::vector<std::string>& left_out) {
  store::MapRecord record;
  record.set_knot_interval_m(map.options.knot_interval_m);
  record.set_clamp_min(map.options.limits.min);
  record.set_clamp_max(map.options.limits.max);
  record.set_layers(static_cast<uint32_t>(layers));
  if (map.own_layer && CheckLayerId(*map.own_layer).ok()) {
    *record.mutable_own_layer() = ToRecord(*map.own_layer);
  }
  for (const auto& [id, setting] : map.settings.records()) {
    if (CheckLayerId(id).ok() && setting.IsValid()) {
      *record.add_settings() = ToRecord(id, setting);
    } else {
      left_out.push_back(fmt::format("a setting about layer {} that cannot be", Shown(id.name)));
    }
  }
  return record;
}

store::LayerRecord LayerRecordOf(const LayerSnapshot& layer, int64_t row,
                                 const std::set<TileKey>& left_out) {
  TileTally tally;
  layer.tiles.ForEach([&](TileKey key, const TileTree::Entry& entry) {
    if (left_out.empty() || !left_out.contains(key)) tally.Add(key, entry.revision);
  });
  store::LayerRecord record;
  record.set_name(layer.id.name);
  record.set_origin(layer.id.origin);
  record.set_session_number(layer.session.number);
  record.set_nonce(layer.session.nonce);
  record.set_revision(layer.revision);
  record.set_saved_utime(HostUtime());
  record.set_tiles(tally.tiles);
  record.set_tiles_digest(tally.digest);
  record.set_row(row);
  return record;
}

absl::Status CheckLayer(const LayerSet& map, const LayerSnapshot& layer) {
  SPLINEMAP_RETURN_IF_ERROR(CheckLayerId(layer.id));
  SPLINEMAP_RETURN_IF_ERROR(CheckSessionId(layer.session));
  SPLINEMAP_RETURN_IF_ERROR(CheckRevision(layer.revision));
  const auto first = std::find_if(map.layers.begin(), map.layers.end(),
                                  [&](const LayerSnapshot& other) { return other.id == layer.id; });
  if (&*first == &layer) return absl::OkStatus();
  return InvalidArgument("it is there twice");
}

absl::Status CheckTileOf(const LayerSnapshot& layer, TileKey key, const TileTree::Entry& entry,
                         ControlLimits limits) {
  if (entry.revision == 0 || entry.revision > layer.revision) {
    return InvalidArgument("tile ({}, {}) of commit {} of {}", key.tx, key.ty, entry.revision,
                           layer.revision);
  }
  return CheckTile(key, *entry.tile, limits);
}

// Writes what changed since the tree's version `since`; `left_out` has the keys that cannot be.
void WriteTiles(const LayerSnapshot& layer, int64_t layer_row, uint64_t since, ControlLimits limits,
                SQLite::Database& database, std::set<TileKey>& left_out) {
  SQLite::Statement put(database,
                        "INSERT INTO tile (layer, tx, ty, revision, checksum, content) "
                        "VALUES (?, ?, ?, ?, ?, ?) ON CONFLICT (layer, tx, ty) DO UPDATE SET "
                        "revision = excluded.revision, checksum = excluded.checksum, "
                        "content = excluded.content");
  SQLite::Statement remove(database, "DELETE FROM tile WHERE layer = ? AND tx = ? AND ty = ?");
  put.bind(1, layer_row);
  remove.bind(1, layer_row);
  layer.tiles.ForEachChanged(since, [&](TileKey key, const TileTree::Entry& entry) {
    if (!CheckTileOf(layer, key, entry, limits).ok()) {
      left_out.insert(key);
      remove.bind(2, key.tx);
      remove.bind(3, key.ty);
      remove.exec();
      remove.reset();
      return;
    }
    left_out.erase(key);
    const std::string content = EncodeTile(*entry.tile);
    put.bind(2, key.tx);
    put.bind(3, key.ty);
    put.bind(4, ToSql(entry.revision));
    put.bind(5, ToSql(ChecksumOfRow(TileChecksum(key, *entry.tile), layer_row, entry.revision)));
    put.bind(6, content.data(), static_cast<int>(content.size()));
    put.exec();
    put.reset();
  });
}

void PutRecord(SQLite::Statement& put, int index, const std::string& bytes) {
  put.bind(index, bytes.data(), static_cast<int>(bytes.size()));
  put.exec();
  put.reset();
}

// The ids of layers in the tables.
std::map<LayerId, int64_t> RowsOfLayers(SQLite::Database& database) {
  std::map<LayerId, int64_t> rows;
  SQLite::Statement layers(database, "SELECT id, name, origin FROM layer");
  while (layers.executeStep()) {
    rows[{layers.getColumn(1).getString(), FromSql(layers.getColumn(2).getInt64())}] =
        layers.getColumn(0).getInt64();
  }
  return rows;
}

// The next id after `row`, which moves there, that no layer and no tile has.
int64_t NextUnusedRow(int64_t& row, SQLite::Statement& in_use) {
  bool is_used = true;
  while (is_used) {
    in_use.bind(1, ++row);
    in_use.executeStep();
    is_used = in_use.getColumn(0).getInt() != 0;
    in_use.reset();
  }
  return row;
}

// Deletes tiles of layers that are not in `rows`, so many at a time that a save stays short. Nobody
// reads them meanwhile, and no other layer gets their number.
void DeleteSomeOld(const std::vector<int64_t>& rows, SQLite::Database& database) {
  constexpr int64_t kMaxTiles = 4096;
  SQLite::Statement next(database, "SELECT min(layer) FROM tile WHERE layer > ?");
  SQLite::Statement remove(database,
                           "DELETE FROM tile WHERE rowid IN "
                           "(SELECT rowid FROM tile WHERE layer = ? LIMIT ?)");
  int64_t row = std::numeric_limits<int64_t>::min();
  int64_t left = kMaxTiles;
  while (left > 0) {
    next.bind(1, row);
    if (!next.executeStep() || next.getColumn(0).isNull()) return;
    row = next.getColumn(0).getInt64();
    next.reset();
    if (std::find(rows.begin(), rows.end(), row) != rows.end()) continue;
    remove.bind(1, row);
    remove.bind(2, left);
    left -= remove.exec();
    remove.reset();
  }
}

}  // namespace

bool SavedLayer::GoesOnAs(const LayerSnapshot& layer) const {
  const bool is_same = tree_lineage == 0 ? layer.id == id : layer.tiles.lineage() == tree_lineage;
  return is_same && layer.tiles.size() >= num_tiles;
}

std::vector<SavedLayer> SavedLayersOf(const LayerSet& map) {
  std::vector<SavedLayer> saved;
  for (const LayerSnapshot& layer : map.layers) {
    saved.push_back(
        {layer.id, layer.tiles.version(), layer.tiles.lineage(), layer.tiles.size(), {}, {}});
  }
  return saved;
}

bool IsUnused(SQLite::Database& database) {
  return database.execAndGet("PRAGMA page_count").getInt() == 0;
}

void MakeSchema(SQLite::Database& database) {
  database.exec("PRAGMA page_size = 4096");  // ForEachRowOfPages() relies on it
  SQLite::Transaction transaction(database);
  database.exec(kSchema);
  database.exec(kArchiveTables);
  database.exec(fmt::format("PRAGMA application_id = {}", kApplicationId));
  database.exec(fmt::format("PRAGMA user_version = {}", kSchemaVersion));
  transaction.commit();
}

void UpgradeSchema(SQLite::Database& database) {
  const int version = VersionOf(database);
  if (version == kSchemaVersion) return;
  SQLite::Transaction transaction(database, SQLite::TransactionBehavior::IMMEDIATE);
  if (version < kArchiveVersion) database.exec(kArchiveTables);
  database.exec(fmt::format("PRAGMA user_version = {}", kSchemaVersion));
  transaction.commit();
}

absl::Status CheckSchema(const std::string& path, SQLite::Database& database) {
  SQLite::Database expected(":memory:", SQLite::OPEN_READWRITE);
  expected.exec(kSchema);
  if (VersionOf(database) >= kArchiveVersion) expected.exec(kArchiveTables);
  const std::vector<std::string> tables = Tables(database);
  const std::vector<std::string> our_tables = Tables(expected);
  const bool has_our_id = database.execAndGet("PRAGMA application_id").getInt() == kApplicationId;
  const bool has_our_text = database.execAndGet("PRAGMA encoding").getString() == "UTF-8";
  const bool is_ours = tables == our_tables;
  if ((has_our_id && !has_our_text) || (!has_our_id && is_ours) ||
      (has_our_id && !is_ours && IsLike(tables, our_tables))) {
    return DataLoss("{} is damaged: its first page", path);
  }
  if (!has_our_id) {
    return InvalidArgument("{} is no map file: it is a database of another program", path);
  }
  const int version = VersionOf(database);
  if (version < kOldestSchemaVersion || version > kSchemaVersion) {
    return FailedPrecondition("{} has schema {} and was made by {} splinemap; this one knows {}",
                              path, version, version > kSchemaVersion ? "a newer" : "an older",
                              kSchemaVersion);
  }
  if (!is_ours) {
    return InvalidArgument("{} is no map file: its tables are not those of a map", path);
  }
  return absl::OkStatus();
}

absl::StatusOr<LoadedMap> ReadMap(const std::string& path, SQLite::Database& database,
                                  SavedArchives* archives) {
  MapReader reader(path);
  SQLite::Statement map_row(database, "SELECT record FROM map");
  while (map_row.executeStep()) reader.ReadMapRow(map_row.getColumn(0).getString());
  SQLite::Statement layers(database, "SELECT id, record FROM layer ORDER BY id");
  while (layers.executeStep()) {
    reader.ReadLayerRow(layers.getColumn(0).getInt64(), layers.getColumn(1).getString());
  }
  if (database.execAndGet("SELECT EXISTS (SELECT 1 FROM tile)").getInt() != 0) reader.NoteTiles();
  SPLINEMAP_RETURN_IF_ERROR(reader.BeginTiles());
  SQLite::Statement tiles(database,
                          "SELECT tx, ty, revision, checksum, content FROM tile WHERE layer = ?");
  for (const int64_t row : reader.LayerRows()) {
    tiles.bind(1, row);
    while (tiles.executeStep()) {
      reader.HandleTile({row, tiles.getColumn(0).getInt64(), tiles.getColumn(1).getInt64(),
                         FromSql(tiles.getColumn(2).getInt64()),
                         FromSql(tiles.getColumn(3).getInt64()), tiles.getColumn(4).getString()});
    }
    tiles.reset();
  }
  if (VersionOf(database) >= kArchiveVersion) reader.archives().Read(database);
  LoadedMap loaded = reader.Finish();
  if (archives != nullptr) *archives = reader.saved_archives();
  return loaded;
}

absl::StatusOr<LoadedMap> ReadMapOfPages(const std::string& path) {
  MapReader reader(path);
  SPLINEMAP_RETURN_IF_ERROR(
      ForEachRowOfPages(path, [&](int64_t rowid, absl::Span<const PageColumn> columns) {
        if (HasForm(columns, kTileForm)) reader.NoteTiles();
        if (HasForm(columns, kMapForm)) reader.ReadMapRow(std::string(columns[1].bytes));
        if (HasForm(columns, kLayerForm)) {
          reader.ReadLayerRow(rowid, std::string(columns[3].bytes));
        }
      }));
  SPLINEMAP_RETURN_IF_ERROR(reader.BeginTiles());
  SPLINEMAP_RETURN_IF_ERROR(ForEachRowOfPages(path, [&](int64_t,
                                                        absl::Span<const PageColumn> columns) {
    if (HasForm(columns, kTileForm)) {
      reader.HandleTile({columns[0].integer, columns[1].integer, columns[2].integer,
                         FromSql(columns[3].integer), FromSql(columns[4].integer),
                         std::string(columns[5].bytes)});
    } else if (HasForm(columns, kBeamsForm)) {
      reader.archives().HandleBlock(ArchiveReader::kBeams, columns[0].integer, columns[1].integer,
                                    FromSql(columns[3].integer), std::string(columns[2].bytes));
    } else if (HasForm(columns, kPosesForm)) {
      reader.archives().HandleBlock(ArchiveReader::kPoses, columns[0].integer, columns[1].integer,
                                    FromSql(columns[2].integer), std::string(columns[3].bytes));
    } else if (HasForm(columns, kBaseTileForm)) {
      reader.archives().HandleBaseTile(columns[0].integer, columns[1].integer, columns[2].integer,
                                       FromSql(columns[3].integer), std::string(columns[4].bytes));
    }
  }));
  return reader.Finish();
}

bool PagesHoldMap(const std::string& path) {
  bool holds_map = false;
  const absl::Status read =
      ForEachRowOfPages(path, [&](int64_t, absl::Span<const PageColumn> columns) {
        const bool is_record = (HasForm(columns, kMapForm) &&
                                RecordOf<store::MapRecord>(std::string(columns[1].bytes))) ||
                               (HasForm(columns, kLayerForm) &&
                                RecordOf<store::LayerRecord>(std::string(columns[3].bytes)));
        holds_map = holds_map || is_record;
      });
  return read.ok() && holds_map;
}

Written WriteMap(const LayerSet& map, const std::vector<SavedLayer>& saved,
                 SQLite::Database& database) {
  Written written;
  const std::map<LayerId, int64_t> known_rows = RowsOfLayers(database);
  SQLite::Statement in_use(
      database,
      "SELECT EXISTS (SELECT 1 FROM layer WHERE id = ?1) OR EXISTS (SELECT 1 FROM tile WHERE "
      "layer = ?1)");
  int64_t last_row = 0;
  int64_t last_archive = 0;
  for (const SavedLayer& known : saved) last_archive = std::max(last_archive, known.archive.id);
  std::vector<int64_t> rows;
  std::vector<store::LayerRecord> records;
  for (const LayerSnapshot& layer : map.layers) {
    if (const absl::Status status = CheckLayer(map, layer); !status.ok()) {
      written.left_out.push_back(
          fmt::format("layer {} that cannot be: {}", Shown(layer.id.name), ErrorText(status)));
      continue;
    }
    SavedLayer state{layer.id, layer.tiles.version(), layer.tiles.lineage(), layer.tiles.size(), {},
                     {}};
    uint64_t since = 0;
    int64_t row = 0;
    SavedArchive saved_archive;
    for (const SavedLayer& known : saved) {
      if (known.id == layer.id) saved_archive = known.archive;
      const auto known_row = known_rows.find(known.id);
      if (!known.GoesOnAs(layer) || known_row == known_rows.end()) continue;
      row = known_row->second;
      since = known.tree_version;
      state.left_out = known.left_out;
    }
    if (row == 0) row = NextUnusedRow(last_row, in_use);
    rows.push_back(row);
    WriteTiles(layer, row, since, map.options.limits, database, state.left_out);
    if (!state.left_out.empty()) {
      const TileKey first = *state.left_out.begin();
      written.left_out.push_back(
          fmt::format("{} tiles of layer {} that cannot be, the first is tile ({}, {})",
                      state.left_out.size(), Shown(layer.id.name), first.tx, first.ty));
    }
    records.push_back(LayerRecordOf(layer, row, state.left_out));
    if (layer.archive != nullptr) {
      state.archive = WriteArchive(*layer.archive, layer.tiles, saved_archive, last_archive,
                                   *records.back().mutable_archive(), database);
    }
    written.saved.push_back(std::move(state));
  }
  DeleteSomeOld(rows, database);
  std::vector<int64_t> archives;
  for (const SavedLayer& layer : written.saved) archives.push_back(layer.archive.id);
  DeleteOtherArchives(archives, database);
  store::MapRecord map_record = MapRecordOf(map, records.size(), written.left_out);
  database.exec("DELETE FROM layer");
  SQLite::Statement put_layer(database,
                              "INSERT INTO layer (id, name, origin, record) VALUES (?, ?, ?, ?)");
  for (const store::LayerRecord& record : records) {
    if (map_record.ByteSizeLong() < kMaxCopiesBytes) *map_record.add_layer() = record;
  }
  SQLite::Statement put_map(database, "INSERT OR REPLACE INTO map (id, record) VALUES (1, ?)");
  PutRecord(put_map, 1, BytesOf(map_record));
  map_record.clear_layer();
  for (store::LayerRecord& record : records) {
    if (&record == &records.front()) *record.mutable_map() = map_record;
    put_layer.bind(1, record.row());
    put_layer.bind(2, record.name());
    put_layer.bind(3, ToSql(record.origin()));
    PutRecord(put_layer, 4, BytesOf(record));
  }
  database.exec(fmt::format("PRAGMA user_version = {}", kSchemaVersion));
  return written;
}

}  // namespace splinemap
