#pragma once

#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "lib/map/map.h"

namespace SQLite {
class Database;
}

namespace splinemap {

// A map as rows of a database (README.md here shows them). Functions throw SQLite::Exception where
// SQLite fails; `path` is what errors call the database.

struct LoadedMap {
  std::shared_ptr<const MapSnapshot> map;
  // What was damaged and left out, a line each.
  std::vector<std::string> damages;
};

// A layer that the rows hold already, up to this state of its tiles.
struct SavedLayer {
  LayerId id;
  uint64_t tree_epoch = 0;
  uint64_t tree_line = 0;  // 0 where it was loaded, and somebody else goes on with it
  size_t num_tiles = 0;

  // Whether `layer` has all of its tiles, so that only changes are to be written.
  bool GoesOnAs(const LayerSnapshot& layer) const;
};
std::vector<SavedLayer> SavedLayersOf(const MapSnapshot& map);

// True for a database that nobody has used yet.
bool IsUnused(SQLite::Database& database);
void MakeSchema(SQLite::Database& database);
// Another program's database (InvalidArgument), another version (FailedPrecondition), or other
// tables than MakeSchema() makes: what they are might run when they are read.
absl::Status CheckSchema(const std::string& path, SQLite::Database& database);

bool HasMap(SQLite::Database& database);

// NotFound where there is no map; DataLoss where the record of the map or of a layer is damaged.
absl::StatusOr<LoadedMap> ReadMap(const std::string& path, SQLite::Database& database);

// Writes the layers of `saved` that go on as far as they changed and all others whole; of layers
// that do not go on, and of those that are not in `saved`, what the database held is gone. Requires
// a transaction.
void WriteMap(const MapSnapshot& map, const std::vector<SavedLayer>& saved,
              SQLite::Database& database);

}  // namespace splinemap
