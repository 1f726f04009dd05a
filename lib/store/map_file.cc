#include "lib/store/map_file.h"

#include <SQLiteCpp/SQLiteCpp.h>
#include <fcntl.h>
#include <sqlite3.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cerrno>
#include <chrono>
#include <cmath>
#include <cstring>
#include <filesystem>
#include <limits>
#include <utility>

#include "lib/base/status.h"
#include "lib/map/tile_update.h"
#include "lib/store/records.pb.h"

namespace splinemap {
namespace {

constexpr int kApplicationId = 0x53504c4d;  // "SPLM"
constexpr int kSchemaVersion = 1;
constexpr int kBusyTimeoutMs = 5000;

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

absl::Status ToStatus(const std::string& path, const SQLite::Exception& exception) {
  switch (exception.getErrorCode()) {
    case SQLITE_NOTADB:
      return InvalidArgument("{} is no map file: it is no SQLite database", path);
    case SQLITE_CORRUPT:
      return DataLoss("{} is damaged: {}", path, exception.what());
    default:
      return Unavailable("{}: {}", path, exception.what());
  }
}

// Runs `work`, which may throw what SQLiteCpp throws, and returns its status.
template <typename Work>
auto WithStatus(const std::string& path, Work work) -> decltype(work()) {
  try {
    return work();
  } catch (const SQLite::Exception& exception) {
    return ToStatus(path, exception);
  }
}

absl::Status CheckHeader(const std::string& path, SQLite::Database& database) {
  const int application_id = database.execAndGet("PRAGMA application_id").getInt();
  const int version = database.execAndGet("PRAGMA user_version").getInt();
  if (application_id != kApplicationId) {
    return InvalidArgument("{} is no map file: it is a database of another program", path);
  }
  if (version > kSchemaVersion) {
    return FailedPrecondition(
        "{} has schema {}; this program knows up to {}: it was made by a newer one", path, version,
        kSchemaVersion);
  }
  return absl::OkStatus();
}

bool IsUnused(SQLite::Database& database) {
  return database.execAndGet("SELECT count(*) FROM sqlite_master").getInt() == 0 &&
         database.execAndGet("PRAGMA application_id").getInt() == 0;
}

void MakeSchema(SQLite::Database& database) {
  SQLite::Transaction transaction(database);
  database.exec(kSchema);
  database.exec(fmt::format("PRAGMA application_id = {}", kApplicationId));
  database.exec(fmt::format("PRAGMA user_version = {}", kSchemaVersion));
  transaction.commit();
}

bool IsPlausible(const store::MapRecord& record) {
  constexpr int kMin = std::numeric_limits<ControlPoint>::min();
  constexpr int kMax = std::numeric_limits<ControlPoint>::max();
  return record.knot_interval_m() > 0 && std::isfinite(record.knot_interval_m()) &&
         record.clamp_min() >= kMin && record.clamp_min() < 0 && record.clamp_max() > 0 &&
         record.clamp_max() <= kMax;
}

bool IsPlausible(const store::LayerRecord& record) {
  constexpr uint64_t kMax = uint64_t{1} << 62;  // leaves room to count on
  return record.incarnation() < kMax && record.revision() < kMax;
}

int64_t HostUtime() {
  return std::chrono::duration_cast<std::chrono::microseconds>(
             std::chrono::system_clock::now().time_since_epoch())
      .count();
}

}  // namespace

// An exclusive flock on the file for as long as it lives. SQLite's own locks are of another kind
// and are held during a transaction only.
class MapFile::Lock {
 public:
  static absl::StatusOr<std::unique_ptr<Lock>> Take(const std::string& path) {
    std::unique_ptr<Lock> lock(new Lock(open(path.c_str(), O_RDWR | O_CREAT | O_CLOEXEC, 0666)));
    if (lock->descriptor_ < 0) {
      return Unavailable("cannot open {} for writing: {}", path, std::strerror(errno));
    }
    if (flock(lock->descriptor_, LOCK_EX | LOCK_NB) != 0) {
      return FailedPrecondition("{} is in use by another process; give another file, or end it",
                                path);
    }
    return lock;
  }
  ~Lock() {
    if (descriptor_ >= 0) close(descriptor_);
  }
  Lock(const Lock&) = delete;
  Lock& operator=(const Lock&) = delete;

  // True where `path` still names the file that is locked.
  bool Holds(const std::string& path) const {
    struct stat locked {};
    struct stat named {};
    return fstat(descriptor_, &locked) == 0 && stat(path.c_str(), &named) == 0 &&
           locked.st_ino == named.st_ino && locked.st_dev == named.st_dev;
  }

 private:
  explicit Lock(int descriptor) : descriptor_(descriptor) {}
  int descriptor_;
};

MapFile::MapFile(std::string path, std::unique_ptr<Lock> lock,
                 std::unique_ptr<SQLite::Database> database)
    : path_(std::move(path)), lock_(std::move(lock)), database_(std::move(database)) {}
MapFile::MapFile(MapFile&&) noexcept = default;
MapFile& MapFile::operator=(MapFile&&) noexcept = default;

MapFile::~MapFile() {
  if (database_) Close().IgnoreError();
}

absl::Status MapFile::Close() {
  return WithStatus(path_, [&]() -> absl::Status {
    if (!database_) return FailedPrecondition("{} is closed", path_);
    const std::unique_ptr<SQLite::Database> database = std::move(database_);
    if (lock_ == nullptr) return absl::OkStatus();  // a reader
    database->exec("PRAGMA wal_checkpoint(TRUNCATE)");
    // Fails while another process reads; then the empty files beside stay.
    sqlite3_exec(database->getHandle(), "PRAGMA journal_mode = DELETE", nullptr, nullptr, nullptr);
    return absl::OkStatus();
  });
}

absl::StatusOr<MapFile> MapFile::Open(const std::string& path) {
  return WithStatus(path, [&]() -> absl::StatusOr<MapFile> {
    SPLINEMAP_ASSIGN_OR_RETURN(std::unique_ptr<Lock> lock, Lock::Take(path));
    auto database = std::make_unique<SQLite::Database>(
        path, SQLite::OPEN_READWRITE | SQLite::OPEN_CREATE, kBusyTimeoutMs);
    if (IsUnused(*database)) MakeSchema(*database);
    SPLINEMAP_RETURN_IF_ERROR(CheckHeader(path, *database));
    database->exec("PRAGMA journal_mode = WAL");
    database->exec("PRAGMA synchronous = FULL");
    return MapFile(path, std::move(lock), std::move(database));
  });
}

absl::StatusOr<MapFile> MapFile::OpenReadOnly(const std::string& path) {
  std::error_code error;
  if (!std::filesystem::exists(path, error)) return NotFound("there is no file {}", path);
  if (!std::filesystem::is_regular_file(path, error)) {
    return InvalidArgument("{} is no map file: it is no file at all", path);
  }
  return WithStatus(path, [&]() -> absl::StatusOr<MapFile> {
    auto database = std::make_unique<SQLite::Database>(path, SQLite::OPEN_READONLY, kBusyTimeoutMs);
    if (IsUnused(*database)) return NotFound("{} holds no map yet", path);
    SPLINEMAP_RETURN_IF_ERROR(CheckHeader(path, *database));
    return MapFile(path, nullptr, std::move(database));
  });
}

absl::StatusOr<bool> MapFile::IsEmpty() {
  return WithStatus(path_, [&]() -> absl::StatusOr<bool> {
    return database_->execAndGet("SELECT count(*) FROM map").getInt() == 0;
  });
}

uint64_t MapFile::SavedTreeEpoch(const LayerId& id) const {
  for (const SavedLayer& layer : saved_) {
    if (layer.id == id) return layer.tree_epoch;
  }
  return 0;
}

absl::StatusOr<LoadedMap> MapFile::Load() {
  return WithStatus(path_, [&] { return LoadUnchecked(); });
}

absl::StatusOr<LoadedMap> MapFile::LoadUnchecked() {
  SQLite::Transaction transaction(*database_);  // one state, though another process may write
  SQLite::Statement map_query(*database_, "SELECT record FROM map");
  if (!map_query.executeStep()) return NotFound("{} holds no map yet", path_);
  store::MapRecord map_record;
  if (!map_record.ParseFromString(map_query.getColumn(0).getString()) || !IsPlausible(map_record)) {
    return DataLoss("{} is damaged: its map record cannot be read", path_);
  }
  Map map({map_record.knot_interval_m(),
           {static_cast<ControlPoint>(map_record.clamp_min()),
            static_cast<ControlPoint>(map_record.clamp_max())}});
  LoadedMap loaded;

  SQLite::Statement layers(*database_, "SELECT id, record FROM layer ORDER BY id");
  SQLite::Statement tiles(*database_,
                          "SELECT tx, ty, revision, checksum, content FROM tile WHERE layer = ?");
  while (layers.executeStep()) {
    store::LayerRecord record;
    if (!record.ParseFromString(layers.getColumn(1).getString()) || !IsPlausible(record)) {
      return DataLoss("{} is damaged: the record of a layer cannot be read", path_);
    }
    Layer& layer =
        map.AddLayer({record.name(), record.origin()}, {record.incarnation(), record.nonce()});
    layer.RestoreRevision(record.revision());
    tiles.reset();
    tiles.bind(1, layers.getColumn(0).getInt64());
    while (tiles.executeStep()) {
      const TileUpdate update{{tiles.getColumn(0).getInt(), tiles.getColumn(1).getInt()},
                              FromSql(tiles.getColumn(2).getInt64()),
                              tiles.getColumn(4).getString(),
                              FromSql(tiles.getColumn(3).getInt64())};
      const bool is_plausible =
          IsInRange(update.key) && update.revision > 0 && update.revision <= record.revision();
      const absl::StatusOr<Tile> tile =
          is_plausible ? TileOfUpdate(update)
                       : DataLoss("tile ({}, {}) of revision {} cannot be", update.key.tx,
                                  update.key.ty, update.revision);
      if (tile.ok()) {
        layer.RestoreTile(update.key, std::make_shared<const Tile>(*tile), update.revision);
      } else {
        loaded.damages.push_back(
            fmt::format("{}: layer {}: {}", path_, record.name(), ErrorText(tile.status())));
      }
    }
  }
  loaded.map = map.Snapshot();
  saved_.clear();
  for (const LayerSnapshot& layer : loaded.map->layers) {
    saved_.push_back({layer.id, layer.tiles.epoch()});
  }
  return loaded;
}

absl::Status MapFile::Save(const MapSnapshot& snapshot) {
  return WithStatus(path_, [&] { return SaveUnchecked(snapshot); });
}

absl::Status MapFile::SaveUnchecked(const MapSnapshot& snapshot) {
  SPLINEMAP_RETURN_IF_ERROR(CheckStillThere());
  SQLite::Transaction transaction(*database_, SQLite::TransactionBehavior::IMMEDIATE);
  store::MapRecord record;
  record.set_knot_interval_m(snapshot.options.knot_interval_m);
  record.set_clamp_min(snapshot.options.limits.min);
  record.set_clamp_max(snapshot.options.limits.max);
  const std::string record_bytes = record.SerializeAsString();
  SQLite::Statement put_map(*database_, "INSERT OR REPLACE INTO map (id, record) VALUES (1, ?)");
  put_map.bind(1, record_bytes.data(), static_cast<int>(record_bytes.size()));
  put_map.exec();

  SQLite::Statement put_tile(*database_,
                             "INSERT OR REPLACE INTO tile (layer, tx, ty, revision, checksum, "
                             "content) VALUES (?, ?, ?, ?, ?, ?)");
  for (const LayerSnapshot& layer : snapshot.layers) {
    put_tile.bind(1, SaveLayerRecord(layer));
    layer.tiles.ForEachChanged(
        SavedTreeEpoch(layer.id), [&](TileKey key, const TileTree::Entry& entry) {
          const TileUpdate update = MakeTileUpdate(key, *entry.tile, entry.revision);
          put_tile.bind(2, update.key.tx);
          put_tile.bind(3, update.key.ty);
          put_tile.bind(4, ToSql(update.revision));
          put_tile.bind(5, ToSql(update.checksum));
          put_tile.bind(6, update.content.data(), static_cast<int>(update.content.size()));
          put_tile.exec();
          put_tile.reset();
        });
  }
  transaction.commit();
  // So that a copy of the one file has all. Waits for nobody: what readers hold up comes with the
  // next.
  sqlite3_wal_checkpoint_v2(database_->getHandle(), nullptr, SQLITE_CHECKPOINT_PASSIVE, nullptr,
                            nullptr);
  saved_.clear();
  for (const LayerSnapshot& layer : snapshot.layers) {
    saved_.push_back({layer.id, layer.tiles.epoch()});
  }
  return absl::OkStatus();
}

absl::Status MapFile::CheckStillThere() const {
  if (lock_ != nullptr && lock_->Holds(path_)) return absl::OkStatus();
  return FailedPrecondition("{} was deleted or replaced while it was in use", path_);
}

int64_t MapFile::SaveLayerRecord(const LayerSnapshot& layer) {
  store::LayerRecord record;
  record.set_name(layer.id.name);
  record.set_origin(layer.id.origin);
  record.set_incarnation(layer.epoch.incarnation);
  record.set_nonce(layer.epoch.nonce);
  record.set_revision(layer.revision);
  record.set_saved_utime(HostUtime());
  const std::string bytes = record.SerializeAsString();
  SQLite::Statement put(*database_,
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

absl::StatusOr<LoadedMap> ReadMapFile(const std::string& path) {
  SPLINEMAP_ASSIGN_OR_RETURN(MapFile file, MapFile::OpenReadOnly(path));
  return file.Load();
}

}  // namespace splinemap
