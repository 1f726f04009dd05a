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

// Which tiles a tree has at which revisions, as a sum in any order. Their content has checksums of
// its own.
struct TileTally {
  uint64_t tiles = 0;
  uint64_t digest = 0;

  void Add(TileKey key, uint64_t revision);
  void Remove(TileKey key, uint64_t revision);
  bool operator==(const TileTally&) const = default;
};

// A layer that the rows hold.
struct SavedLayer {
  LayerId id;
  int64_t row = 0;  // of the table, and the tree of its tiles
  TileTree tiles;
  TileTally tally;             // of those that are not left out
  std::set<TileKey> left_out;  // they cannot be
  SavedArchive archive{};
};

// True for a database that nobody has used yet.
bool IsUnused(SQLite::Database& database);
void MakeSchema(SQLite::Database& database);
// Another program's database (InvalidArgument), another version (FailedPrecondition), or other
// tables than MakeSchema() makes: what they are might run when they are read. DataLoss where that
// looks like damage: the pages can be read then, which runs nothing.
absl::Status CheckSchema(const std::string& path, SQLite::Database& database);

// What the tables of a database hold.
struct ReadRows {
  LoadedMap map;
  std::vector<SavedLayer> saved;  // for WriteMap(); of a database of today's schema
};

// What can be read of a map, and what cannot. A damaged record of the map or of a layer is replaced
// by its copy, if the file has one; of a record that cannot be true only what cannot be is left
// out. NotFound where there is no map; DataLoss where nothing says what its options are.
// Where `rows` is given, it becomes the source of the tiles, and those that something bounds are
// not read until somebody asks for them; `rows` is made when the limits are known.
using MakeTileRows = absl::FunctionRef<std::shared_ptr<TileRows>(ControlLimits)>;
absl::StatusOr<ReadRows> ReadMap(const std::string& path, SQLite::Database& database,
                                 MakeTileRows make_rows);
// The same from the pages of the file, for a database that is damaged. Reads the file that SQLite
// may have open, and so ends its locks.
absl::StatusOr<LoadedMap> ReadMapOfPages(const std::string& path);

// Whether the pages of a file hold an intact record of a map or a layer.
bool PagesHoldMap(const std::string& path);

// Empty tables of today in place of those that are there. Requires a transaction.
void RemakeTables(SQLite::Database& database);

// Deletes some thousand rows of tiles that nobody has any more, in a transaction of its own.
void DeleteForgottenRows(TileRows& rows, SQLite::Database& database);

// Writes a map in one transaction, which is the caller's.
class MapRowWriter {
 public:
  MapRowWriter(std::shared_ptr<TileRows> rows, SQLite::Database& database);
  // Without a Finish(), nothing has been written.
  ~MapRowWriter();

  // Writes what layers have other than `saved`, which the database holds. Layers that are not in
  // `map` are deleted. What validity.h and LayerSettings::IsValid() refuse is left out, a line each
  // in `problems`. Requires options that can be.
  void Write(const LayerSet& map, const std::vector<SavedLayer>& saved,
             std::vector<std::string>& problems);

  // After the transaction.
  struct Written {
    std::vector<SavedLayer> saved;  // what the database holds now
    TreeWriter::Numbers numbers;    // of the rows of tiles, who are to be told: SetSource()
  };
  Written Finish();

 private:
  void WriteRecords(const LayerSet& map, std::vector<store::LayerRecord> records,
                    std::vector<std::string>& problems);
  void DeleteUnusedRows();

  const std::shared_ptr<TileRows> rows_;
  SQLite::Database& database_;
  TreeWriter trees_;
  std::vector<SavedLayer> saved_;
  std::vector<int64_t> forgotten_;
  int64_t deleted_rows_ = 0;
};

}  // namespace splinemap
