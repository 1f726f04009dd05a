#include <SQLiteCpp/Backup.h>
#include <SQLiteCpp/SQLiteCpp.h>
#include <fcntl.h>
#include <sqlite3.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <filesystem>
#include <utility>

#include "absl/cleanup/cleanup.h"
#include "lib/base/clock.h"
#include "lib/base/file.h"
#include "lib/base/status.h"
#include "lib/layers/validity.h"
#include "lib/store/map_records.h"
#include "lib/store/page_scan.h"
#include "lib/store/tile_rows.h"
#include "splinemap/file.h"

namespace splinemap {
namespace {

constexpr int kBusyTimeoutMs = 5000;

// A failed fsync: what was written since the last may be lost, though it can still be read.
bool IsFailedSync(int extended_error_code) {
  return extended_error_code == SQLITE_IOERR_FSYNC || extended_error_code == SQLITE_IOERR_DIR_FSYNC;
}

absl::Status ToStatus(const std::string& path, const SQLite::Exception& exception) {
  switch (exception.getErrorCode()) {
    case SQLITE_NOTADB:
      return InvalidArgument("{} is no map file: it is no SQLite database", path);
    case SQLITE_CORRUPT:
    case SQLITE_TOOBIG:
    case SQLITE_ERROR:  // the same statements work on every sound file
      return DataLoss("{} is damaged: {}", path, exception.what());
    case SQLITE_FULL:
      return Unavailable("cannot write {}: the disk is full", path);
    case SQLITE_READONLY:
      return Unavailable("cannot write {}: it or its folder is read-only", path);
    case SQLITE_CANTOPEN:
      return Unavailable(
          "cannot open {}: it was in use when it was copied or left, and its folder cannot be "
          "written; copy it to another folder, with the files beside it (-wal)",
          path);
    case SQLITE_BUSY:
      return Unavailable("{} is in use by another process", path);
    case SQLITE_IOERR:
      return Unavailable("{}: the disk {}", path,
                         IsFailedSync(exception.getExtendedErrorCode())
                             ? "did not keep what was written to it"
                             : "failed");
    default:
      return Unavailable("{}: {}", path, exception.what());
  }
}

std::unique_ptr<SQLite::Database> Connect(const std::string& path, int flags) {
  auto database = std::make_unique<SQLite::Database>(path, flags, kBusyTimeoutMs);
  GuardConnection(*database);
  // Pages out of use hold no rows then that could be taken for rows of a damaged file.
  database->exec("PRAGMA secure_delete = ON");
  return database;
}

int64_t UsedBytes(SQLite::Database& database) {
  return database
      .execAndGet(
          "SELECT (page_count - freelist_count) * page_size FROM pragma_page_count, "
          "pragma_freelist_count, pragma_page_size")
      .getInt64();
}

size_t CountTiles(const LayerSet& map) {
  size_t tiles = 0;
  for (const LayerSnapshot& layer : map.layers) tiles += layer.tiles.size();
  return tiles;
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

// Brings the commits of a database that stand beside it alone into its one file.
absl::Status BringTogether(const std::string& path) {
  std::error_code error;
  if (!std::filesystem::exists(path + "-wal", error) &&
      !std::filesystem::exists(path + "-journal", error)) {
    return absl::OkStatus();
  }
  const absl::Status status = WithStatus(path, [&]() -> absl::Status {
    const std::unique_ptr<SQLite::Database> database = Connect(path, SQLite::OPEN_READWRITE);
    const bool is_read = database->execAndGet("PRAGMA wal_checkpoint(TRUNCATE)").getInt() != 0;
    return is_read ? Unavailable("{} is in use by another process", path) : absl::OkStatus();
  });
  if (!absl::IsDataLoss(status) && !absl::IsInvalidArgument(status)) return status;
  return PagesHoldMap(path) ? CheckpointPages(path) : absl::OkStatus();
}

// Gives the closed map `from` the name of `to`. Whenever the power fails, `to` is the old map with
// all of its commits, or the new one.
absl::Status MoveOver(const std::string& from, const std::string& to) {
  std::error_code error;
  if (std::filesystem::exists(to, error)) SPLINEMAP_RETURN_IF_ERROR(BringTogether(to));
  // What an old map has in files beside it would be taken for the new one's.
  for (const char* beside : {"-wal", "-shm", "-journal"}) {
    std::filesystem::remove(to + beside, error);
  }
  SPLINEMAP_RETURN_IF_ERROR(SyncFolderOf(to));
  std::filesystem::rename(from, to, error);
  if (error) return Unavailable("cannot write {}: {}", to, error.message());
  return SyncFolderOf(to);
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
  if (rows_) rows_->End();
}

struct MapFile::Written : MapRowWriter::Written {
  std::vector<std::string> problems;
};

absl::Status MapFile::Close() {
  return WithStatus(path_, [&]() -> absl::Status {
    if (!database_) return FailedPrecondition("{} is closed", path_);
    is_closed_ = true;
    const std::unique_ptr<SQLite::Database> database = std::move(database_);
    if (lock_ == nullptr) return absl::OkStatus();  // a reader
    // What cannot be deleted now is swept by those who open the file next.
    try {
      if (rows_ && is_known_) DeleteForgottenRows(*rows_, *database);
    } catch (const SQLite::Exception&) {
    }
    if (rows_) rows_->End();
    if (rows_) rows_->Disconnect(path_);
    database->exec("PRAGMA wal_checkpoint(TRUNCATE)");
    // Fails while another process reads; then the empty files beside stay.
    const int error = sqlite3_exec(database->getHandle(), "PRAGMA journal_mode = DELETE", nullptr,
                                   nullptr, nullptr);
    if (error == SQLITE_IOERR || error == SQLITE_FULL) {
      throw SQLite::Exception(database->getHandle(), error);
    }
    return absl::OkStatus();
  });
}

absl::StatusOr<MapFile> MapFile::OpenDatabase(const std::string& path, std::unique_ptr<Lock> lock,
                                              std::shared_ptr<TileMemory> memory) {
  const bool is_writer = lock != nullptr;
  MapFile file(path, std::move(lock), nullptr);
  file.memory_ = std::move(memory);
  absl::Status schema;
  const absl::Status status = WithStatus(path, [&]() -> absl::Status {
    file.database_ = Connect(
        path, is_writer ? SQLite::OPEN_READWRITE | SQLite::OPEN_CREATE : SQLite::OPEN_READONLY);
    if (IsUnused(*file.database_)) {
      if (!is_writer) return NotFound("{} holds no map yet", path);
      MakeSchema(*file.database_);
    }
    schema = CheckSchema(path, *file.database_);
    if (!schema.ok() || !is_writer) return schema;
    file.database_->exec("PRAGMA journal_mode = WAL");
    file.database_->exec("PRAGMA synchronous = FULL");
    file.log_pages_ = std::make_unique<int>(0);
    const auto count_pages = [](void* log_pages, sqlite3*, const char*, int pages) {
      *static_cast<int*>(log_pages) = pages;
      return SQLITE_OK;
    };
    sqlite3_wal_hook(file.database_->getHandle(), count_pages, file.log_pages_.get());
    return absl::OkStatus();
  });
  if (status.ok()) return file;
  // With a damaged first page a map looks like no database.
  const bool may_be_damaged =
      absl::IsDataLoss(status) || (absl::IsInvalidArgument(status) && schema.ok());
  file.database_ = nullptr;
  if (!may_be_damaged || !PagesHoldMap(path)) return status;
  file.damage_ = status;
  return file;
}

absl::StatusOr<MapFile> MapFile::Open(const std::string& path, std::shared_ptr<TileMemory> memory) {
  SPLINEMAP_ASSIGN_OR_RETURN(std::unique_ptr<Lock> lock, Lock::Take(path));
  return OpenDatabase(path, std::move(lock), std::move(memory));
}

absl::StatusOr<std::vector<std::string>> MapFile::WriteNew(const std::string& path,
                                                           const LayerSet& set) {
  SPLINEMAP_RETURN_IF_ERROR(CheckMapOptions(set.options));
  SPLINEMAP_ASSIGN_OR_RETURN(std::unique_ptr<Lock> lock, Lock::Take(path));
  MapFile file(path, std::move(lock), nullptr);
  return WithStatus(path, [&]() -> absl::StatusOr<std::vector<std::string>> {
    file.database_ = Connect(path, SQLite::OPEN_READWRITE | SQLite::OPEN_CREATE);
    if (!IsUnused(*file.database_)) return FailedPrecondition("{} is no new file", path);
    // A journal would write everything twice, to undo what is not left after a failure anyway.
    file.database_->exec("PRAGMA journal_mode = OFF");
    file.database_->exec("PRAGMA synchronous = FULL");
    MakeSchema(*file.database_);
    std::vector<std::string> problems = file.Write(set).problems;
    SPLINEMAP_RETURN_IF_ERROR(file.Close());
    return problems;
  });
}

absl::Status MapFile::CheckNotInUse(const std::string& path) {
  std::error_code error;
  if (!std::filesystem::exists(path, error)) return absl::OkStatus();
  return Lock::Take(path).status();
}

void MapFile::Remove(const std::string& path) {
  std::error_code error;
  // The map last: who is killed here leaves what TemporaryPathFor() finds.
  for (const char* beside : {"-wal", "-shm", "-journal", ""}) {
    std::filesystem::remove(path + beside, error);
  }
}

absl::Status MapFile::Copy(const std::string& from, const std::string& to) {
  SPLINEMAP_ASSIGN_OR_RETURN(const MapFile source, OpenReadOnly(from));
  if (!source.damage_.ok()) return DataLoss("{} is damaged: {}", from, ErrorText(source.damage_));
  return WithStatus(to, [&]() -> absl::Status {
    SQLite::Database copy(to, SQLite::OPEN_READWRITE | SQLite::OPEN_CREATE);
    // In one step, for else it begins again with every save.
    if (SQLite::Backup(copy, *source.database_).executeStep() != SQLITE_DONE) {
      return Unavailable("{} is in use by another process", from);
    }
    copy.exec("PRAGMA journal_mode = DELETE");  // one file
    return absl::OkStatus();
  });
}

absl::Status MapFile::Rename(const std::string& from, const std::string& to) {
  std::error_code error;
  std::unique_ptr<Lock> lock;
  if (std::filesystem::exists(to, error)) {
    SPLINEMAP_ASSIGN_OR_RETURN(lock, Lock::Take(to));
  }
  return MoveOver(from, to);
}

absl::StatusOr<MapFile> MapFile::OpenReadOnly(const std::string& path) {
  std::error_code error;
  if (!std::filesystem::exists(path, error)) {
    return NotFound("there is no file {}", path);
  }
  if (!std::filesystem::is_regular_file(path, error)) {
    return InvalidArgument("{} is no map file: it is {}", path,
                           std::filesystem::is_directory(path, error) ? "a folder" : "no file");
  }
  if (access(path.c_str(), R_OK) != 0) {
    return Unavailable("cannot read {}: {}", path, std::strerror(errno));
  }
  return OpenDatabase(path, nullptr, nullptr);
}

absl::StatusOr<LoadedMap> MapFile::Load() {
  absl::StatusOr<LoadedMap> loaded;  // no map
  if (damage_.ok()) {
    std::vector<SavedLayer> saved;
    const auto make_rows = [&](ControlLimits limits) -> std::shared_ptr<TileRows> {
      if (lock_ == nullptr) return nullptr;  // what a reader reads goes on changing
      rows_ = std::make_shared<TileRows>(path_, limits, memory_);
      if (memory_) rows_->Connect();
      return rows_;
    };
    loaded = WithStatus(path_, [&]() -> absl::StatusOr<LoadedMap> {
      if (!database_) return FailedPrecondition("{} is closed", path_);
      SQLite::Transaction transaction(*database_);  // one state, though another process may write
      absl::StatusOr<ReadRows> read = ReadMap(path_, *database_, make_rows);
      // A disk that loses what it has synced can leave pages that two trees take for theirs: all
      // can be read, and the next save would overwrite it. Of a large map that takes too long.
      constexpr size_t kMaxTilesChecked = 16'384;
      const bool is_checked =
          read.ok() ? read->map.corruption.empty() && CountTiles(read->map.set) <= kMaxTilesChecked
                    : absl::IsNotFound(read.status());
      if (is_checked) {
        std::string order = database_->execAndGet("PRAGMA integrity_check(1)").getString();
        database_->exec("PRAGMA shrink_memory");
        if (order != "ok" && !read.ok()) return DataLoss("{} is damaged: {}", path_, order);
        if (order != "ok") read->map.corruption.push_back(std::move(order));
      }
      SPLINEMAP_RETURN_IF_ERROR(read.status());
      saved = std::move(read->saved);
      return std::move(read->map);
    });
    if (loaded.ok() && loaded->corruption.empty()) {
      is_known_ = rows_ != nullptr;
      saved_ = std::move(saved);
      return loaded;
    }
    if (!loaded.ok() && !absl::IsDataLoss(loaded.status())) return loaded;
    damage_ = loaded.ok() ? DataLoss("{} is damaged", path_) : loaded.status();
  }
  // Closed, since SQLite's locks end when the scan closes the file.
  database_ = nullptr;
  if (rows_) rows_->Disconnect(path_);
  absl::StatusOr<LoadedMap> scanned = ReadMapOfPages(path_);
  if (scanned.ok() && (!loaded.ok() || CountTiles(scanned->set) >= CountTiles(loaded->set))) {
    const bool is_all_there = scanned->corruption.empty();
    if (!loaded.ok() || is_all_there) {
      scanned->corruption.insert(scanned->corruption.begin(),
                                 ErrorText(damage_) + "; its pages are read one by one" +
                                     (is_all_there ? ", and nothing is missing" : ""));
    }
    loaded = std::move(scanned);
  }
  if (loaded.ok() && lock_ != nullptr) {
    SPLINEMAP_ASSIGN_OR_RETURN(loaded->kept_copy, KeepDamaged());
  }
  return loaded;
}

MapFile::Written MapFile::Write(const LayerSet& set) {
  SQLite::Transaction transaction(*database_, SQLite::TransactionBehavior::IMMEDIATE);
  if (!is_known_) {
    RemakeTables(*database_);
    rows_ = std::make_shared<TileRows>(path_, set.options.limits, memory_);
  }
  Written written;
  MapRowWriter writer(rows_, *database_);
  writer.Write(set, saved_, written.problems);
  transaction.commit();
  static_cast<MapRowWriter::Written&>(written) = writer.Finish();
  return written;
}

void MapFile::Adopt(Written written) {
  if (memory_) rows_->Connect();
  for (const auto& [tile, number] : written.numbers) tile->SetSource(rows_, number);
  saved_ = std::move(written.saved);
  is_known_ = true;
}

// So that a copy of the one file has nearly all. Not with each save: the same pages change with
// many of them. Waits for nobody: what readers hold up comes with the next.
void MapFile::MoveLogIntoFile() {
  constexpr int kMaxLogPages = 1024;
  constexpr std::chrono::seconds kInterval(10);
  const Clock::time_point now = Clock::now();
  if (last_move_ && now - *last_move_ < kInterval && *log_pages_ < kMaxLogPages) return;
  last_move_ = now;
  sqlite3* const handle = database_->getHandle();
  sqlite3_wal_checkpoint_v2(handle, nullptr, SQLITE_CHECKPOINT_PASSIVE, nullptr, nullptr);
  if (IsFailedSync(sqlite3_extended_errcode(handle))) throw SQLite::Exception(handle);
}

absl::StatusOr<std::vector<std::string>> MapFile::Save(const LayerSet& set) {
  using Problems = std::vector<std::string>;
  SPLINEMAP_RETURN_IF_ERROR(CheckMapOptions(set.options));
  if (!IsThere()) {
    return FailedPrecondition("{} was deleted or replaced while it was in use", path_);
  }
  const bool was_given_up = database_ == nullptr && !is_closed_;
  if (!damage_.ok() || was_given_up) return Renew(set);
  bool is_failed_sync = false;
  absl::StatusOr<Problems> saved = WithStatus(path_, [&]() -> absl::StatusOr<Problems> {
    if (!database_) return FailedPrecondition("{} is closed", path_);
    try {
      Written written = Write(set);
      Problems problems = std::move(written.problems);
      Adopt(std::move(written));
      used_bytes_ = UsedBytes(*database_);
      MoveLogIntoFile();
      for (std::string& problem : rows_->TakeProblems()) problems.push_back(std::move(problem));
      return problems;
    } catch (const SQLite::Exception& exception) {
      is_failed_sync = IsFailedSync(exception.getExtendedErrorCode());
      throw;
    }
  });
  if (!is_failed_sync && !absl::IsDataLoss(saved.status())) return saved;
  damage_ = saved.status();
  database_ = nullptr;
  if (is_failed_sync) {
    SPLINEMAP_ASSIGN_OR_RETURN(Problems problems, Renew(set));
    problems.push_back(fmt::format("{}; it is written anew", ErrorText(saved.status())));
    return problems;
  }
  SPLINEMAP_ASSIGN_OR_RETURN(const std::string copy, KeepDamaged());
  SPLINEMAP_ASSIGN_OR_RETURN(Problems problems, Renew(set));
  problems.push_back(
      fmt::format("{}; it is written anew, and was kept as {}", ErrorText(saved.status()), copy));
  return problems;
}

// A name beside for the file and its -wal; a copy where the file system has no links.
absl::StatusOr<std::string> MapFile::KeepDamaged() const {
  std::error_code error;
  struct stat file {};
  if (stat(path_.c_str(), &file) != 0) {
    return Unavailable("cannot read {}: {}", path_, std::strerror(errno));
  }
  // The same for the same file, however often it is found damaged.
  const std::string copy =
      fmt::format("{}.{:x}-{:x}.damaged", path_, file.st_ino, file.st_mtim.tv_sec);
  for (const char* beside : {"", "-wal"}) {
    if (!std::filesystem::exists(path_ + beside, error)) continue;
    if (std::filesystem::exists(copy + beside, error)) continue;
    std::filesystem::create_hard_link(path_ + beside, copy + beside, error);
    if (!error) continue;
    const std::string part = TemporaryPathFor(copy);
    std::filesystem::copy_file(path_ + beside, part, error);
    if (!error && SyncFile(part).ok()) std::filesystem::rename(part, copy + beside, error);
    if (!std::filesystem::exists(copy + beside)) {
      std::filesystem::remove(part, error);
      return Unavailable("{} is damaged, and no copy of it can be kept: cannot write {}", path_,
                         copy);
    }
  }
  SPLINEMAP_RETURN_IF_ERROR(SyncFolderOf(copy));
  return copy;
}

// Goes on in a new file that replaces the damaged one.
absl::StatusOr<std::vector<std::string>> MapFile::Renew(const LayerSet& set) {
  const std::string part = TemporaryPathFor(path_);
  const absl::Cleanup remove_part = [&] { Remove(part); };
  SPLINEMAP_ASSIGN_OR_RETURN(MapFile fresh, Open(part, memory_));
  absl::StatusOr<Written> written =
      WithStatus(part, [&]() -> absl::StatusOr<Written> { return fresh.Write(set); });
  SPLINEMAP_RETURN_IF_ERROR(written.status());
  std::vector<std::string> problems = std::move(written->problems);
  const std::shared_ptr<TileRows> rows = std::exchange(fresh.rows_, nullptr);
  SPLINEMAP_RETURN_IF_ERROR(fresh.Close());
  if (rows_) rows_->Connect();  // tiles that others have go on being read from the damaged one
  SPLINEMAP_RETURN_IF_ERROR(MoveOver(part, path_));
  if (rows_) rows_->Part();
  if (rows_) rows_->End();
  SPLINEMAP_ASSIGN_OR_RETURN(*this, OpenDatabase(path_, std::move(fresh.lock_), memory_));
  rows->Disconnect(path_);
  rows_ = rows;
  Adopt(*std::move(written));
  return problems;
}

bool MapFile::IsThere() const { return lock_ != nullptr && lock_->Holds(path_); }

absl::StatusOr<std::vector<std::string>> MapFile::SaveElsewhere(const std::string& path,
                                                                const LayerSet& set) {
  if (!IsThere()) {
    // What its -wal has would be taken for what replaced it, unless that is in use already.
    database_ = nullptr;
    std::error_code error;
    if (CheckNotInUse(path_).ok()) {
      std::filesystem::remove(path_ + "-wal", error);
      std::filesystem::remove(path_ + "-shm", error);
    }
  }
  const int created = open(path.c_str(), O_RDWR | O_CREAT | O_EXCL | O_CLOEXEC, 0666);
  if (created < 0) return Unavailable("cannot write {}: {}", path, std::strerror(errno));
  close(created);
  const auto save = [&]() -> absl::StatusOr<std::vector<std::string>> {
    SPLINEMAP_ASSIGN_OR_RETURN(MapFile fresh, Open(path, memory_));
    absl::StatusOr<Written> written =
        WithStatus(path, [&]() -> absl::StatusOr<Written> { return fresh.Write(set); });
    SPLINEMAP_RETURN_IF_ERROR(written.status());
    std::vector<std::string> problems = std::move(written->problems);
    fresh.Adopt(*std::move(written));
    if (rows_) rows_->Part();
    if (rows_) rows_->End();
    *this = std::move(fresh);
    return problems;
  };
  absl::StatusOr<std::vector<std::string>> saved = save();
  if (!saved.ok()) Remove(path);
  return saved;
}

absl::StatusOr<LoadedMap> ReadMapFile(const std::string& path) {
  SPLINEMAP_ASSIGN_OR_RETURN(MapFile file, MapFile::OpenReadOnly(path));
  return file.Load();
}

}  // namespace splinemap
