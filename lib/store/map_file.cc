#include "lib/store/map_file.h"

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

#include "lib/base/status.h"

namespace splinemap {
namespace {

constexpr int kBusyTimeoutMs = 5000;
constexpr int kMaxRowBytes = 1 << 20;

absl::Status ToStatus(const std::string& path, const SQLite::Exception& exception) {
  switch (exception.getErrorCode()) {
    case SQLITE_NOTADB:
      return InvalidArgument("{} is no map file: it is no SQLite database", path);
    case SQLITE_CORRUPT:
    case SQLITE_TOOBIG:
      return DataLoss("{} is damaged: {}; take a copy of it, or build it again from a log", path,
                      exception.what());
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
    default:
      return Unavailable("{}: {}", path, exception.what());
  }
}

std::unique_ptr<SQLite::Database> Connect(const std::string& path, int flags) {
  auto database = std::make_unique<SQLite::Database>(path, flags, kBusyTimeoutMs);
  // A file may come from anywhere.
  database->exec("PRAGMA trusted_schema = OFF");
  database->exec("PRAGMA cell_size_check = ON");
  sqlite3_limit(database->getHandle(), SQLITE_LIMIT_LENGTH, kMaxRowBytes);
  return database;
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
    auto database = Connect(path, SQLite::OPEN_READWRITE | SQLite::OPEN_CREATE);
    if (IsUnused(*database)) MakeSchema(*database);
    SPLINEMAP_RETURN_IF_ERROR(CheckSchema(path, *database));
    database->exec("PRAGMA journal_mode = WAL");
    database->exec("PRAGMA synchronous = FULL");
    return MapFile(path, std::move(lock), std::move(database));
  });
}

absl::Status MapFile::CheckNotInUse(const std::string& path) {
  std::error_code error;
  if (!std::filesystem::exists(path, error)) return absl::OkStatus();
  return Lock::Take(path).status();
}

absl::Status MapFile::Rename(const std::string& from, const std::string& to) {
  std::error_code error;
  std::unique_ptr<Lock> lock;
  if (std::filesystem::exists(to, error)) {
    SPLINEMAP_ASSIGN_OR_RETURN(lock, Lock::Take(to));
    // What an old map has in files beside it would be taken for the new one's.
    std::filesystem::remove(to + "-wal", error);
    std::filesystem::remove(to + "-shm", error);
  }
  std::filesystem::rename(from, to, error);
  if (error) return Unavailable("cannot write {}: {}", to, error.message());
  return absl::OkStatus();
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
  return WithStatus(path, [&]() -> absl::StatusOr<MapFile> {
    auto database = Connect(path, SQLite::OPEN_READONLY);
    if (IsUnused(*database)) return NotFound("{} holds no map yet", path);
    SPLINEMAP_RETURN_IF_ERROR(CheckSchema(path, *database));
    return MapFile(path, nullptr, std::move(database));
  });
}

absl::StatusOr<bool> MapFile::IsEmpty() {
  return WithStatus(path_, [&]() -> absl::StatusOr<bool> { return !HasMap(*database_); });
}

absl::StatusOr<LoadedMap> MapFile::Load() {
  return WithStatus(path_, [&]() -> absl::StatusOr<LoadedMap> {
    SQLite::Transaction transaction(*database_);  // one state, though another process may write
    SPLINEMAP_ASSIGN_OR_RETURN(LoadedMap loaded, ReadMap(path_, *database_));
    // The next save of a damaged map writes it whole, and so mends it.
    saved_.clear();
    if (loaded.damages.empty()) saved_ = SavedLayersOf(*loaded.map);
    for (SavedLayer& layer : saved_) layer.tree_line = 0;  // an editor of the caller's goes on
    return loaded;
  });
}

absl::Status MapFile::Save(const MapSnapshot& snapshot) {
  return WithStatus(path_, [&]() -> absl::Status {
    SPLINEMAP_RETURN_IF_ERROR(CheckStillThere());
    SQLite::Transaction transaction(*database_, SQLite::TransactionBehavior::IMMEDIATE);
    WriteMap(snapshot, saved_, *database_);
    transaction.commit();
    // So that a copy of the one file has all. Waits for nobody: what readers hold up comes with the
    // next.
    sqlite3_wal_checkpoint_v2(database_->getHandle(), nullptr, SQLITE_CHECKPOINT_PASSIVE, nullptr,
                              nullptr);
    saved_ = SavedLayersOf(snapshot);
    return absl::OkStatus();
  });
}

absl::Status MapFile::CheckStillThere() const {
  if (lock_ != nullptr && lock_->Holds(path_)) return absl::OkStatus();
  return FailedPrecondition("{} was deleted or replaced while it was in use", path_);
}

absl::StatusOr<LoadedMap> ReadMapFile(const std::string& path) {
  SPLINEMAP_ASSIGN_OR_RETURN(MapFile file, MapFile::OpenReadOnly(path));
  return file.Load();
}

}  // namespace splinemap
