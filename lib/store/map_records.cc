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
#include <tuple>
#include <utility>

#include "absl/container/flat_hash_map.h"
#include "absl/container/flat_hash_set.h"
#include "absl/strings/escaping.h"
#include "lib/base/host_clock.h"
#include "lib/base/status.h"
#include "lib/layers/validity.h"
#include "lib/store/page_scan.h"
#include "lib/store/settings_record.h"
#include "lib/store/records.pb.h"
#include "lib/tiles/tile_codec.h"

namespace splinemap {
namespace {

constexpr int kApplicationId = 0x53504c4d;  // "SPLM"
constexpr int kSchemaVersion = 6;
constexpr int kSquareVersion = 6;   // from which on trees have squares; 5 and 4 have a base table
constexpr int kArchiveVersion = 4;  // from which on there are archives
constexpr int kOldestSchemaVersion = 2;  // whose rows and records say less

// From here on the record of the map has no more copies of those of layers: rows are bounded.
constexpr size_t kMaxCopiesBytes = 512 * 1024;

constexpr const char* kRecordTables = R"(
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
)";
// Of files before squares.
constexpr const char* kKeyedTileTable = R"(
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

// The columns of the tables, which tell in a page what a row is of: i for integer, b for bytes.
constexpr std::string_view kMapForm = "ib";
constexpr std::string_view kLayerForm = "ibib";
constexpr std::string_view kKeyedTileForm = "iiiiib";

bool HasForm(absl::Span<const PageColumn> columns, std::string_view form) {
  return std::equal(
      columns.begin(), columns.end(), form.begin(), form.end(),
      [](const PageColumn& column, char kind) { return column.is_bytes == (kind == 'b'); });
}

// Whether two copies of a record say the same. They do not where a disk that has lost what it
// synced has left pages of several saves.
template <typename Record>
bool IsSame(Record a, Record b) {
  a.clear_checksum();
  b.clear_checksum();
  return a.SerializeAsString() == b.SerializeAsString();
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
    } else if (map_record_ && map_copy_) {
      store::MapRecord record = *map_record_;
      record.clear_layer();
      if (!IsSame(std::move(record), *map_copy_)) {
        Damage("the records of the map and of its layers are of different saves");
      }
    }
    if (!map_record_)
      return DataLoss("{} is damaged: no record of its knot interval is left", path_);
    set_.options = *OptionsOf(*map_record_);
    archives_.emplace(set_.options.limits);
    for (const store::LayerRecord& copy : map_record_->layer()) {
      if (records_.try_emplace(copy.row(), copy).second) {
        Damage(fmt::format("the record of layer {} cannot be read; its copy is used",
                           Shown(copy.name())));
      } else if (store::LayerRecord record = records_.at(copy.row());
                 record.clear_map(), !IsSame(std::move(record), copy)) {
        Damage(fmt::format("the record of layer {} is of another save than that of the map",
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

  // The trees of squares that the records tell of: of layers, and of the bases of their archives.
  std::vector<int64_t> Trees() const {
    std::vector<int64_t> trees = LayerRows();
    for (const auto& [row, reading] : layers_) {
      const store::LayerRecord& record = records_.at(row);
      if (record.has_archive() && !record.archive().base_is_layer()) {
        trees.push_back(TreeOfBase(record.archive().id()));
      }
    }
    return trees;
  }

  int64_t RowOf(const LayerId& id) const {
    const auto found = std::find_if(layers_.begin(), layers_.end(), [&](const auto& reading) {
      return reading.second.layer->id() == id;
    });
    return found->first;
  }

  size_t NumTiles() const {
    size_t tiles = 0;
    for (const auto& [row, reading] : layers_) tiles += records_.at(row).tiles();
    return tiles;
  }

  // The tile of a layer, where it is there already.
  std::shared_ptr<const StoredTile> TileOfLayer(int64_t row, TileKey key) const {
    const auto found = layers_.find(row);
    return found == layers_.end() ? nullptr : found->second.layer->tiles().Share(key);
  }

  void HandleDamagedSquare(const absl::Status& status) { Damage(ErrorText(status)); }

  using ReadTile = absl::StatusOr<std::shared_ptr<const StoredTile>>;
  // A tile that a square of the tree names; the error where it cannot be read.
  void HandleEntry(int64_t tree, const SquareEntry& entry, ReadTile tile) {
    if (tree < 0) {
      if (tile.ok()) archives_->AddBaseTile(TreeOfBase(tree), entry.key, *std::move(tile));
      return;  // Finish() counts them
    }
    HandleTile(tree, entry.key, entry.revision, std::move(tile));
  }

  // Of a table of tiles by their keys.
  void HandleKeyedTile(const TileRow& row) {
    const std::optional<TileKey> key = KeyOf(row.tx, row.ty);
    if (!key) {
      const auto found = layers_.find(row.layer);
      if (found != layers_.end()) DamageOf(found->second, TextOfOdd(row.tx, row.ty, row.revision));
      return;
    }
    const absl::StatusOr<Tile> tile = TileOfRow(row, *key, set_.options.limits);
    HandleTile(row.layer, *key, row.revision,
               tile.ok() ? ReadTile(std::make_shared<const StoredTile>(*tile)) : tile.status());
  }

  // A square that can be read: what it does not have is older.
  void NoteSquare(int64_t tree, int64_t x, int64_t y) { squares_.insert({tree, x, y}); }

  // A tile that no square has that can be read: the newest of its key, for want of a better one.
  void HandleLooseTile(const TileRow& row) {
    const auto found = layers_.find(row.layer);
    const std::optional<TileKey> key = KeyOf(row.tx, row.ty);
    if (found == layers_.end() || !key || row.revision == 0 ||
        squares_.contains({row.layer, PlaceInSquares(key->tx), PlaceInSquares(key->ty)}) ||
        row.revision > found->second.max_revision) {
      return;
    }
    const absl::StatusOr<Tile> tile = TileOfRow(row, *key, set_.options.limits);
    if (!tile.ok()) return;
    std::pair<uint64_t, Tile>& loose = found->second.loose[*key];
    if (loose.first < row.revision) loose = {row.revision, *tile};
  }

  // Valid after BeginTiles().
  ArchiveReader& archives() { return *archives_; }
  ControlLimits limits() const { return set_.options.limits; }
  int64_t tile_rows() const { return static_cast<int64_t>(map_record_->tile_rows()); }
  // Valid after Finish().
  const std::map<LayerId, SavedArchive>& saved_archives() const { return saved_archives_; }

  LoadedMap Finish() {
    for (auto& [row, reading] : layers_) RestoreLoose(reading, records_.at(row));
    std::map<LayerId, std::shared_ptr<const ScanArchive>> archives;
    for (const auto& [row, reading] : layers_) {
      const store::LayerRecord& record = records_.at(row);
      const ArchiveReader::Result result = archives_->Finish(
          record.has_archive() ? &record.archive() : nullptr, reading.layer->Snapshot().tiles);
      for (const std::string& damage : result.damage) DamageOf(reading, damage);
      archives[reading.layer->id()] = result.archive;
      saved_counts_[reading.layer->id()] = {static_cast<int64_t>(record.tiles()),
                                            record.archive().scans()};
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
    return {std::move(set_), std::move(saved_counts_), std::move(corruption_), {}};
  }

 private:
  struct Reading {
    Layer* layer = nullptr;
    uint64_t max_revision = 0;  // that a tile may have
    TileTally tally;
    std::map<TileKey, std::pair<uint64_t, Tile>> loose;  // with their revisions
  };

  static std::string TextOfOdd(int64_t tx, int64_t ty, uint64_t revision) {
    return fmt::format("tile ({}, {}) of revision {} cannot be", tx, ty, revision);
  }

  void HandleTile(int64_t row, TileKey key, uint64_t revision, ReadTile tile) {
    const auto found = layers_.find(row);
    if (found == layers_.end()) return;  // of a layer that is gone
    Reading& reading = found->second;
    if (revision == 0 || revision > reading.max_revision) {
      DamageOf(reading, TextOfOdd(key.tx, key.ty, revision));
      return;
    }
    reading.tally.Add(key, revision);
    if (tile.ok()) {
      reading.layer->RestoreTile(key, *std::move(tile), revision);
    } else {
      DamageOf(reading, ErrorText(tile.status()));
    }
  }

  static void RestoreLoose(Reading& reading, const store::LayerRecord& record) {
    if (reading.tally.tiles >= record.tiles()) return;
    for (const auto& [key, loose] : reading.loose) {
      if (reading.layer->tiles().Find(key) != nullptr) continue;
      reading.layer->RestoreTile(key, std::make_shared<const StoredTile>(loose.second),
                                 loose.first);
      reading.tally.Add(key, loose.first);
    }
  }

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
        layers_[row] = {&layer, revision_status.ok() ? record.revision() : kMaxRevision, {}, {}};
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
  absl::flat_hash_set<std::tuple<int64_t, int64_t, int64_t>> squares_;
  std::optional<ArchiveReader> archives_;
  std::map<LayerId, SavedArchive> saved_archives_;
  std::map<LayerId, SavedCounts> saved_counts_;
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

store::LayerRecord LayerRecordOf(const LayerSnapshot& layer, int64_t row, const TileTally& tally) {
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
  return CheckTile(key, *entry.tile->Get(), limits);
}

// Goes on from the layer that the rows hold: which tiles cannot be, and what all others come to.
void FollowChanges(const LayerSnapshot& layer, ControlLimits limits, SavedLayer& saved) {
  TileTree::ForEachDifference(
      saved.tiles, layer.tiles,
      [&](TileKey key, const TileTree::Entry* was, const TileTree::Entry* is) {
        const bool was_left_out = saved.left_out.erase(key) > 0;
        if (was != nullptr && !was_left_out) saved.tally.Remove(key, was->revision);
        if (is == nullptr) return;
        const bool is_new = was == nullptr || was->tile != is->tile || was_left_out;
        if (is->revision == 0 || is->revision > layer.revision ||
            (is_new && !CheckTileOf(layer, key, *is, limits).ok())) {
          saved.left_out.insert(key);
        } else {
          saved.tally.Add(key, is->revision);
        }
      });
  saved.tiles = layer.tiles;
  saved.id = layer.id;
}

constexpr size_t kMaxRowsAtOnce = 4096;  // so that a save stays short

int64_t DeleteRows(absl::Span<const int64_t> numbers, SQLite::Database& database) {
  SQLite::Statement remove(database, "DELETE FROM tile WHERE number = ?");
  int64_t deleted = 0;
  for (const int64_t number : numbers) {
    remove.bind(1, number);
    deleted += remove.exec();
    remove.reset();
  }
  return deleted;
}

void PutRecord(SQLite::Statement& put, int index, const std::string& bytes) {
  put.bind(index, bytes.data(), static_cast<int>(bytes.size()));
  put.exec();
  put.reset();
}

}  // namespace

void TileTally::Add(TileKey key, uint64_t revision) {
  const std::array<uint64_t, 3> row{FromSql(key.tx), FromSql(key.ty), revision};
  ++tiles;
  digest += XXH3_64bits(row.data(), sizeof row);
}

void TileTally::Remove(TileKey key, uint64_t revision) {
  TileTally removed;
  removed.Add(key, revision);
  tiles -= removed.tiles;
  digest -= removed.digest;
}

bool IsUnused(SQLite::Database& database) {
  return database.execAndGet("PRAGMA page_count").getInt() == 0;
}

void MakeSchema(SQLite::Database& database) {
  database.exec("PRAGMA page_size = 4096");  // ForEachRowOfPages() relies on it
  SQLite::Transaction transaction(database);
  database.exec(fmt::format("PRAGMA application_id = {}", kApplicationId));
  RemakeTables(database);
  transaction.commit();
}

void RemakeTables(SQLite::Database& database) {
  for (const char* table :
       {"map", "layer", "tile", "tile_square", "scan_beams", "scan_poses", "base_tile"}) {
    database.exec(fmt::format("DROP TABLE IF EXISTS {}", table));
  }
  for (const char* tables : {kRecordTables, kTileTables, kScanTables}) database.exec(tables);
  database.exec(fmt::format("PRAGMA user_version = {}", kSchemaVersion));
}

absl::Status CheckSchema(const std::string& path, SQLite::Database& database) {
  SQLite::Database expected(":memory:", SQLite::OPEN_READWRITE);
  const int version = VersionOf(database);
  expected.exec(kRecordTables);
  expected.exec(version >= kSquareVersion ? kTileTables : kKeyedTileTable);
  if (version >= kArchiveVersion) expected.exec(kScanTables);
  if (version >= kArchiveVersion && version < kSquareVersion) expected.exec(kBaseTable);
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

namespace {

void ReadKeyedTiles(SQLite::Database& database, MapReader& reader) {
  SQLite::Statement tiles(database,
                          "SELECT tx, ty, revision, checksum, content FROM tile WHERE layer = ?");
  for (const int64_t row : reader.LayerRows()) {
    tiles.bind(1, row);
    while (tiles.executeStep()) {
      reader.HandleKeyedTile({0, row, tiles.getColumn(0).getInt64(), tiles.getColumn(1).getInt64(),
                              FromSql(tiles.getColumn(2).getInt64()),
                              FromSql(tiles.getColumn(3).getInt64()),
                              tiles.getColumn(4).getString()});
    }
    tiles.reset();
  }
}

// Finds the tiles of squares.
class SquareReader {
 public:
  SquareReader(std::shared_ptr<TileRows> rows, SQLite::Database& database, MapReader& reader)
      : rows_(std::move(rows)), tiles_(database, reader.limits()), reader_(reader) {
    // A small map is read at once, and so is what is damaged of it.
    constexpr size_t kMaxAtOnce = 16'384;
    TileMemory* const memory = rows_ == nullptr ? nullptr : rows_->memory();
    reads_later_ =
        memory != nullptr && reader_.NumTiles() > std::min(kMaxAtOnce, memory->max_tiles());
  }

  void Read(SQLite::Database& database) {
    SQLite::Statement squares(database,
                              "SELECT x, y, content, checksum FROM tile_square WHERE tree = ?");
    for (const int64_t tree : reader_.Trees()) {
      squares.bind(1, tree);
      while (squares.executeStep()) {
        const auto entries = EntriesOfSquare(
            tree, squares.getColumn(0).getInt64(), squares.getColumn(1).getInt64(),
            squares.getColumn(2).getString(), FromSql(squares.getColumn(3).getInt64()));
        if (!entries.ok()) reader_.HandleDamagedSquare(entries.status());
        if (!entries.ok()) continue;
        for (const SquareEntry& entry : *entries) {
          reader_.HandleEntry(tree, entry, TileOf(tree, entry));
        }
      }
      squares.reset();
    }
  }

  const absl::flat_hash_set<int64_t>& numbers() const { return numbers_; }

 private:
  MapReader::ReadTile TileOf(int64_t tree, const SquareEntry& entry) {
    const bool is_first = numbers_.insert(entry.number).second;
    if (!is_first && tree < 0 && rows_ != nullptr) {
      // A base has tiles of its layer.
      for (const int64_t row : reader_.LayerRows()) {
        auto tile = reader_.TileOfLayer(row, entry.key);
        if (tile != nullptr && tile->NumberAt(rows_.get()) == entry.number) return tile;
      }
    }
    const bool has_row = is_first && rows_ != nullptr;
    if (has_row && reads_later_) {
      return std::make_shared<const StoredTile>(rows_, entry.number, entry.checksum, entry.touched);
    }
    SPLINEMAP_ASSIGN_OR_RETURN(const Tile content, tiles_.Read(entry.number, entry.checksum));
    auto tile = std::make_shared<const StoredTile>(content);
    if (tile->Checksum(entry.key) != entry.checksum) {
      return DataLoss("tile ({}, {}) is another", entry.key.tx, entry.key.ty);
    }
    if (has_row) tile->SetSource(rows_, entry.number);
    return tile;
  }

  const std::shared_ptr<TileRows> rows_;
  TileReader tiles_;
  MapReader& reader_;
  bool reads_later_ = false;
  absl::flat_hash_set<int64_t> numbers_;
};

}  // namespace

absl::StatusOr<ReadRows> ReadMap(const std::string& path, SQLite::Database& database,
                                 MakeTileRows make_rows) {
  MapReader reader(path);
  SQLite::Statement map_row(database, "SELECT record FROM map");
  while (map_row.executeStep()) reader.ReadMapRow(map_row.getColumn(0).getString());
  SQLite::Statement layers(database, "SELECT id, record FROM layer ORDER BY id");
  while (layers.executeStep()) {
    reader.ReadLayerRow(layers.getColumn(0).getInt64(), layers.getColumn(1).getString());
  }
  if (database.execAndGet("SELECT EXISTS (SELECT 1 FROM tile)").getInt() != 0) reader.NoteTiles();
  SPLINEMAP_RETURN_IF_ERROR(reader.BeginTiles());
  const int version = VersionOf(database);
  ReadRows read;
  if (version < kSquareVersion) {
    ReadKeyedTiles(database, reader);
    if (version >= kArchiveVersion) reader.archives().ReadScans(database);
    if (version >= kArchiveVersion) reader.archives().ReadBaseTable(database);
    read.map = reader.Finish();
    return read;
  }
  const std::shared_ptr<TileRows> rows = make_rows(reader.limits());
  SquareReader squares(rows, database, reader);
  squares.Read(database);
  reader.archives().ReadScans(database);
  read.map = reader.Finish();
  if (rows != nullptr) {
    const auto last = database.execAndGet("SELECT ifnull(max(number), 0) FROM tile");
    rows->BeginWith(last.getInt64(), reader.tile_rows(), squares.numbers());
  }
  for (const LayerSnapshot& layer : read.map.set.layers) {
    SavedLayer saved{.id = layer.id,
                     .row = reader.RowOf(layer.id),
                     .tiles = layer.tiles,
                     .tally = {},
                     .left_out = {},
                     .archive = reader.saved_archives().at(layer.id)};
    layer.tiles.ForEach(
        [&](TileKey key, const TileTree::Entry& entry) { saved.tally.Add(key, entry.revision); });
    read.saved.push_back(std::move(saved));
  }
  return read;
}

absl::StatusOr<LoadedMap> ReadMapOfPages(const std::string& path) {
  MapReader reader(path);
  struct Claim {
    int64_t tree;
    SquareEntry entry;
  };
  absl::flat_hash_map<int64_t, std::vector<Claim>> claims;  // by number
  SPLINEMAP_RETURN_IF_ERROR(
      ForEachRowOfPages(path, [&](int64_t rowid, absl::Span<const PageColumn> columns) {
        if (HasForm(columns, kTileForm) || HasForm(columns, kKeyedTileForm)) reader.NoteTiles();
        if (HasForm(columns, kMapForm)) reader.ReadMapRow(std::string(columns[1].bytes));
        if (HasForm(columns, kLayerForm)) {
          reader.ReadLayerRow(rowid, std::string(columns[3].bytes));
        }
        if (!HasForm(columns, kSquareForm)) return;
        const int64_t tree = columns[0].integer;
        const auto entries =
            EntriesOfSquare(tree, columns[1].integer, columns[2].integer,
                            std::string(columns[3].bytes), FromSql(columns[4].integer));
        if (!entries.ok()) return;  // what it had is missed
        reader.NoteSquare(tree, columns[1].integer, columns[2].integer);
        for (const SquareEntry& entry : *entries) claims[entry.number].push_back({tree, entry});
      }));
  SPLINEMAP_RETURN_IF_ERROR(reader.BeginTiles());
  const auto handle_tile = [&](const TileRow& row) {
    const auto found = claims.find(row.number);
    if (found == claims.end()) return reader.HandleLooseTile(row);
    for (const auto& [tree, entry] : found->second) {
      const absl::StatusOr<Tile> tile = TileOfRow(row, entry.key, reader.limits());
      if (tile.ok() && TileChecksum(entry.key, *tile) == entry.checksum) {
        reader.HandleEntry(tree, entry, std::make_shared<const StoredTile>(*tile));
      } else {
        reader.HandleEntry(tree, entry,
                           tile.ok()
                               ? DataLoss("tile ({}, {}) is another", entry.key.tx, entry.key.ty)
                               : tile.status());
      }
    }
  };
  SPLINEMAP_RETURN_IF_ERROR(ForEachRowOfPages(path, [&](int64_t rowid,
                                                        absl::Span<const PageColumn> columns) {
    if (HasForm(columns, kTileForm)) {
      handle_tile({rowid, columns[1].integer, columns[2].integer, columns[3].integer,
                   FromSql(columns[4].integer), FromSql(columns[5].integer),
                   std::string(columns[6].bytes)});
    } else if (HasForm(columns, kKeyedTileForm)) {
      reader.HandleKeyedTile({0, columns[0].integer, columns[1].integer, columns[2].integer,
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

MapRowWriter::MapRowWriter(std::shared_ptr<TileRows> rows, SQLite::Database& database)
    : rows_(std::move(rows)), database_(database), trees_(*rows_, database) {}

MapRowWriter::~MapRowWriter() { rows_->GiveBack(forgotten_); }

void MapRowWriter::Write(const LayerSet& map, const std::vector<SavedLayer>& saved,
                         std::vector<std::string>& problems) {
  int64_t last_row = 0;
  int64_t last_archive = 0;
  for (const SavedLayer& known : saved) {
    last_row = std::max(last_row, known.row);
    last_archive = std::max(last_archive, known.archive.id);
  }
  std::vector<store::LayerRecord> records;
  std::vector<int64_t> trees;
  std::vector<int64_t> archives;
  for (const LayerSnapshot& layer : map.layers) {
    if (const absl::Status status = CheckLayer(map, layer); !status.ok()) {
      problems.push_back(
          fmt::format("layer {} that cannot be: {}", Shown(layer.id.name), ErrorText(status)));
      continue;
    }
    SavedLayer state;
    for (const SavedLayer& known : saved) {
      if (known.id == layer.id) state = known;
    }
    const SavedLayer before = state;
    if (state.row == 0) state.row = ++last_row;
    const int64_t row = state.row;
    FollowChanges(layer, map.options.limits, state);
    if (const int64_t lost = trees_.Write(row, row, before.tiles, layer.tiles, state.left_out);
        lost > 0) {
      problems.push_back(fmt::format("{} tiles of layer {} that cannot be read where they are",
                                     lost, Shown(layer.id.name)));
    }
    trees.push_back(row);
    if (!state.left_out.empty()) {
      const TileKey first = *state.left_out.begin();
      problems.push_back(
          fmt::format("{} tiles of layer {} that cannot be, the first is tile ({}, {})",
                      state.left_out.size(), Shown(layer.id.name), first.tx, first.ty));
    }
    records.push_back(LayerRecordOf(layer, row, state.tally));
    if (layer.archive != nullptr) {
      state.archive = WriteArchive(*layer.archive, layer.tiles, before.archive, last_archive,
                                   *records.back().mutable_archive(), trees_, database_);
      archives.push_back(state.archive.id);
      trees.push_back(TreeOfBase(state.archive.id));
    } else {
      state.archive = {};
    }
    saved_.push_back(std::move(state));
  }
  trees_.DeleteOtherTrees(trees);
  DeleteOtherArchives(archives, database_);
  DeleteUnusedRows();
  WriteRecords(map, std::move(records), problems);
}

void MapRowWriter::DeleteUnusedRows() {
  forgotten_ = rows_->TakeForgotten(kMaxRowsAtOnce);
  deleted_rows_ +=
      DeleteRows(forgotten_, database_) + DeleteRows(rows_->Sweep(database_), database_);
}

void DeleteForgottenRows(TileRows& rows, SQLite::Database& database) {
  SQLite::Transaction transaction(database, SQLite::TransactionBehavior::IMMEDIATE);
  const int64_t deleted = DeleteRows(rows.TakeForgotten(kMaxRowsAtOnce), database);
  if (deleted == 0) return;
  const auto num_rows = static_cast<uint64_t>(rows.num_rows() - deleted);
  SQLite::Statement map_row(database, "SELECT record FROM map");
  if (!map_row.executeStep()) return;
  auto map_record = RecordOf<store::MapRecord>(map_row.getColumn(0).getString());
  map_row.reset();
  if (!map_record) return;
  map_record->set_tile_rows(num_rows);
  SQLite::Statement put_map(database, "UPDATE map SET record = ?");
  PutRecord(put_map, 1, BytesOf(*map_record));
  // And in the copy of it.
  std::map<int64_t, std::string> changed;
  SQLite::Statement layer_rows(database, "SELECT id, record FROM layer");
  while (layer_rows.executeStep()) {
    auto record = RecordOf<store::LayerRecord>(layer_rows.getColumn(1).getString());
    if (!record || !record->has_map()) continue;
    record->mutable_map()->set_tile_rows(num_rows);
    changed[layer_rows.getColumn(0).getInt64()] = BytesOf(*record);
  }
  layer_rows.reset();
  SQLite::Statement put_layer(database, "UPDATE layer SET record = ? WHERE id = ?");
  for (const auto& [id, record] : changed) {
    put_layer.bind(2, id);
    PutRecord(put_layer, 1, record);
  }
  transaction.commit();
  rows.CountRows(-deleted);
}

void MapRowWriter::WriteRecords(const LayerSet& map, std::vector<store::LayerRecord> records,
                                std::vector<std::string>& problems) {
  store::MapRecord map_record = MapRecordOf(map, records.size(), problems);
  map_record.set_tile_rows(
      static_cast<uint64_t>(rows_->num_rows() + trees_.num_written() - deleted_rows_));
  database_.exec("DELETE FROM layer");
  SQLite::Statement put_layer(database_,
                              "INSERT INTO layer (id, name, origin, record) VALUES (?, ?, ?, ?)");
  for (const store::LayerRecord& record : records) {
    if (map_record.ByteSizeLong() < kMaxCopiesBytes) *map_record.add_layer() = record;
  }
  SQLite::Statement put_map(database_, "INSERT OR REPLACE INTO map (id, record) VALUES (1, ?)");
  PutRecord(put_map, 1, BytesOf(map_record));
  map_record.clear_layer();
  for (store::LayerRecord& record : records) {
    if (&record == &records.front()) *record.mutable_map() = map_record;
    put_layer.bind(1, record.row());
    put_layer.bind(2, record.name());
    put_layer.bind(3, ToSql(record.origin()));
    PutRecord(put_layer, 4, BytesOf(record));
  }
}

MapRowWriter::Written MapRowWriter::Finish() {
  forgotten_.clear();
  rows_->CountRows(trees_.num_written() - deleted_rows_);
  return {std::move(saved_), trees_.TakeNumbers()};
}

}  // namespace splinemap
