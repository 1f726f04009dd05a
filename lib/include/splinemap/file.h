#pragma once

#include <chrono>
#include <cstdint>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "splinemap/layer_set.h"

namespace SQLite {
class Database;
}

namespace splinemap {

struct SavedLayer;
class TileMemory;
class TileRows;

// What a layer had when it was saved.
struct SavedCounts {
  int64_t tiles = 0;
  int64_t scans = 0;  // that are kept
};

// What was read of a file.
struct LoadedMap {
  LayerSet set;
  std::map<LayerId, SavedCounts> saved;  // of each layer of the set
  // What was damaged and left out, a line each.
  std::vector<std::string> corruption;
  std::string kept_copy;  // of the damaged file, where MapFile::Load() made one
};

// A map in a SQLite database, by convention NAME.splinemap: the record of the map, one per layer,
// one row per tile (lib/store/README.md shows the schema). Each Save() is one transaction, so that
// a crash at any moment leaves the state of one save. While open for writing there are two files
// beside it (-wal, -shm). Thread-compatible.
class MapFile {
 public:
  // Opens for writing, which one process at a time can; makes the file where there is none. Errors
  // say what is in the way: another process (FailedPrecondition), no
  // permission, no SQLite database, a database of something else, a newer schema.
  // `memory` bounds how many tiles are in memory: those that were used last; of a large map none is
  // read before it is used, and what is damaged shows then. Null: all are.
  static absl::StatusOr<MapFile> Open(const std::string& path,
                                      std::shared_ptr<TileMemory> memory = nullptr);
  // Opens for reading a file that exists; another process may be writing to it.
  static absl::StatusOr<MapFile> OpenReadOnly(const std::string& path);

  // Writes a whole map into a new file, in less time than Save(), and closes it: for a file in the
  // making, which is to be removed after a failure or a crash. Returns problems as Save() does.
  static absl::StatusOr<std::vector<std::string>> WriteNew(const std::string& path,
                                                           const LayerSet& set);

  // FailedPrecondition where another process writes to the file. It need not be a map.
  static absl::Status CheckNotInUse(const std::string& path);
  // Removes a map and what stands beside it, if they are there.
  static void Remove(const std::string& path);
  // Writes what stands in the file, page by page, into a new one: the last save, also while another
  // process writes. DataLoss where SQLite cannot read it; other damage is copied, too.
  static absl::Status Copy(const std::string& from, const std::string& to);
  // Gives the closed map `from` the name of `to`, whatever `to` was, unless it is in use.
  static absl::Status Rename(const std::string& from, const std::string& to);

  MapFile(MapFile&&) noexcept;
  MapFile& operator=(MapFile&&) noexcept;
  ~MapFile();

  // The last save, or what can be read of it. NotFound where nothing was saved yet; DataLoss where
  // nothing says what the map's options are. Of a damaged file a writer keeps a copy beside;
  // Unavailable where it cannot.
  absl::StatusOr<LoadedMap> Load();

  // Writes what changed since the last save of this object or its Load(); all of it the first time,
  // and where the file is damaged, into a new one in its place. A layer that is gone is deleted.
  // Requires equal map options. Returns problems that did
  // not keep it from saving, a line each: what was left out since it cannot be true
  // (lib/map/validity.h), tiles that could not be read since the last save, or that the file was
  // damaged and is written anew. After a failure (the
  // disk is full, the file was deleted or replaced) the file is as it was, and the next save writes
  // what this one did not.
  absl::StatusOr<std::vector<std::string>> Save(const LayerSet& set);

  // The same for all of the map, in a new file at `path`, where nothing may stand, and goes on
  // there: for a file that is not there any more or cannot be written. After a failure nothing has
  // changed.
  absl::StatusOr<std::vector<std::string>> SaveElsewhere(const std::string& path,
                                                         const LayerSet& set);

  // False where the file was deleted or replaced, or its folder is gone.
  bool IsThere() const;
  const std::string& path() const { return path_; }
  // Of pages that are in use, as of the last save; 0 before.
  int64_t used_bytes() const { return used_bytes_; }

  // Brings everything into the one file; every later call fails. The destructor does the same and
  // keeps silent. While another process reads, the files beside may stay, with nothing in them.
  absl::Status Close();

 private:
  class Lock;

  MapFile(std::string path, std::unique_ptr<Lock> lock, std::unique_ptr<SQLite::Database> database);
  static absl::StatusOr<MapFile> OpenDatabase(const std::string& path, std::unique_ptr<Lock> lock,
                                              std::shared_ptr<TileMemory> memory);
  struct Written;
  // Writes in one transaction what `set` has other than the last save.
  Written Write(const LayerSet& set);
  void Adopt(Written written);
  void MoveLogIntoFile();
  absl::StatusOr<std::string> KeepDamaged() const;
  absl::StatusOr<std::vector<std::string>> Renew(const LayerSet& set);

  std::string path_;
  std::unique_ptr<Lock> lock_;  // of a writer; outlives database_
  std::optional<std::chrono::steady_clock::time_point> last_move_;  // of the log into the file
  std::unique_ptr<int> log_pages_;  // of a writer: in the -wal, after the last transaction
  std::unique_ptr<SQLite::Database> database_;  // null where it is closed or damaged
  absl::Status damage_;                         // why the pages have to be read
  std::shared_ptr<TileMemory> memory_;
  std::shared_ptr<TileRows> rows_;  // of a writer, once the limits of tiles are known
  int64_t used_bytes_ = 0;
  bool is_closed_ = false;
  bool is_known_ = false;  // the tables hold saved_, and nothing else
  std::vector<SavedLayer> saved_;
};

// Reads a map for looking at it. NotFound where the file does not exist or holds no map yet.
absl::StatusOr<LoadedMap> ReadMapFile(const std::string& path);

}  // namespace splinemap
