#pragma once

#include <cstdint>
#include <map>
#include <memory>
#include <set>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "lib/store/archive_rows.h"
#include "splinemap/file.h"
#include "splinemap/layer_set.h"

namespace SQLite {
class Database;
}

namespace splinemap {

// A map as rows of a database (README.md here shows them). Functions throw SQLite::Exception where
// SQLite fails; `path` is what errors call the database.

// A layer that the rows hold already, up to this state of its tiles.
struct SavedLayer {
  LayerId id;
  uint64_t tree_version = 0;
  uint64_t tree_lineage = 0;  // 0 where it was loaded, and somebody else goes on with it
  size_t num_tiles = 0;
  std::set<TileKey> left_out;  // they cannot be
  SavedArchive archive{};

  // Whether `layer` has all of its tiles, so that only changes are to be written; it may have
  // another name by now.
  bool GoesOnAs(const LayerSnapshot& layer) const;
};
std::vector<SavedLayer> SavedLayersOf(const LayerSet& map);

// True for a database that nobody has used yet.
bool IsUnused(SQLite::Database& database);
void MakeSchema(SQLite::Database& database);
// Makes the tables of today in a database of an older version that CheckSchema() accepts.
void UpgradeSchema(SQLite::Database& database);
// Another program's database (InvalidArgument), another version (FailedPrecondition), or other
// tables than MakeSchema() makes: what they are might run when they are read. DataLoss where that
// looks like damage: the pages can be read then, which runs nothing.
absl::Status CheckSchema(const std::string& path, SQLite::Database& database);

// What can be read of a map, and what cannot. A damaged record of the map or of a layer is replaced
// by its copy, if the file has one; of a record that cannot be true only what cannot be is left
// out. NotFound where there is no map; DataLoss where nothing says what its options are.
// `archives` becomes which rows hold them.
using SavedArchives = std::map<LayerId, SavedArchive>;
absl::StatusOr<LoadedMap> ReadMap(const std::string& path, SQLite::Database& database,
                                  SavedArchives* archives = nullptr);
// The same from the pages of the file, for a database that is damaged. Reads the file that SQLite
// may have open, and so ends its locks.
absl::StatusOr<LoadedMap> ReadMapOfPages(const std::string& path);

// Whether the pages of a file hold an intact record of a map or a layer.
bool PagesHoldMap(const std::string& path);

struct Written {
  std::vector<SavedLayer> saved;
  std::vector<std::string> left_out;  // what cannot be true, a line each
};

// Writes the layers of `saved` that go on as far as they changed and all others whole; of layers
// that do not go on, and of those that are not in `saved`, nothing that the database held is read
// any more, and some thousand rows are deleted with each call. What
// validity.h and LayerSettings::IsValid() refuse is left out. Requires options that can be, and a
// transaction.
Written WriteMap(const LayerSet& map, const std::vector<SavedLayer>& saved,
                 SQLite::Database& database);

}  // namespace splinemap
