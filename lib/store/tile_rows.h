#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <set>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "absl/container/flat_hash_map.h"
#include "absl/container/flat_hash_set.h"
#include "absl/status/statusor.h"
#include "absl/types/span.h"
#include "lib/base/mutex.h"
#include "lib/tiles/tile_memory.h"
#include "splinemap/tile_tree.h"

namespace SQLite {
class Database;
class Statement;
}  // namespace SQLite

namespace splinemap {

namespace store {
class SquareRecord;
}

// Tiles as rows of a database. A row never changes: a tile that does gets another, and its number
// is free when nobody has the tile any more. Which rows a tree is made of stands in its squares, of
// 8 x 8 tiles each: square (x, y) of tiles 8 x - 4 .. 8 x + 3, 8 y - 4 .. 8 y + 3, a leaf of a
// KeyTree. Functions throw SQLite::Exception where SQLite fails.

inline constexpr const char* kTileTables = R"(
  CREATE TABLE tile (
    number INTEGER PRIMARY KEY,
    layer INTEGER NOT NULL,
    tx INTEGER NOT NULL,
    ty INTEGER NOT NULL,
    revision INTEGER NOT NULL,
    checksum INTEGER NOT NULL,
    content BLOB NOT NULL
  ) STRICT;
  CREATE TABLE tile_square (
    tree INTEGER NOT NULL,
    x INTEGER NOT NULL,
    y INTEGER NOT NULL,
    content BLOB NOT NULL,
    checksum INTEGER NOT NULL,
    PRIMARY KEY (tree, x, y)
  ) STRICT;
)";
// The columns of their rows: i for integer, b for bytes.
inline constexpr std::string_view kTileForm = "iiiiiib";
inline constexpr std::string_view kSquareForm = "iiibi";

// Of every connection to a map file, which may come from anywhere: no function of its schema is
// called, no broken page is read, and no row is larger than any of ours.
void GuardConnection(SQLite::Database& database);

struct TileRow {
  int64_t number = 0;
  int64_t layer = 0;  // when it was written, as well as the revision
  int64_t tx = 0;
  int64_t ty = 0;
  uint64_t revision = 0;
  uint64_t checksum = 0;
  std::string content;
};

// What `checksum` of a row says: that of the tile, bound to the layer and the revision, so that no
// row of a damaged page is taken for another's.
uint64_t ChecksumOfRow(uint64_t tile_checksum, int64_t layer_row, uint64_t revision);
// Nothing where there can be no such tile.
std::optional<TileKey> KeyOf(int64_t tx, int64_t ty);
// DataLoss where the row is damaged; other errors where a tile cannot be so.
absl::StatusOr<Tile> TileOfRow(const TileRow& row, TileKey key, ControlLimits limits);

// The x or y of the square that a tile of this tx or ty is in.
inline int32_t PlaceInSquares(int32_t tile) { return (tile + 4) >> 3; }

// A tile of a tree, as a square says.
struct SquareEntry {
  TileKey key;
  int64_t number = 0;
  uint64_t revision = 0;
  uint64_t checksum = 0;  // TileChecksum()
  TouchedPoints touched;
};
uint64_t ChecksumOfSquare(int64_t tree, int64_t x, int64_t y, const std::string& content);
// DataLoss where it is damaged.
absl::StatusOr<std::vector<SquareEntry>> EntriesOfSquare(int64_t tree, int64_t x, int64_t y,
                                                         const std::string& content,
                                                         uint64_t checksum);

// The tiles of a map file that are not in memory, read in a connection of its own. Thread-safe.
class TileRows : public TileSource {
 public:
  TileRows(std::string path, ControlLimits limits, std::shared_ptr<TileMemory> memory);
  ~TileRows() override;

  // Where it is null, TakeProblems() tells.
  std::shared_ptr<const Tile> Load(int64_t number, uint64_t checksum) override;
  void Forget(int64_t number) override;
  // The row stays: the trees of this file still have it.
  void Leave(int64_t /*number*/) override {}

  // The table has so many rows, up to that number; those that are not `in_use` are to be swept.
  void BeginWith(int64_t last_number, int64_t num_rows, absl::flat_hash_set<int64_t> in_use);
  int64_t NewNumber();
  int64_t num_rows() const { return num_rows_; }
  // After a transaction that added rows or deleted some.
  void CountRows(int64_t added) { num_rows_ += added; }

  // Rows whose tiles nobody has any more, to be deleted.
  std::vector<int64_t> TakeForgotten(size_t max_numbers);
  void GiveBack(absl::Span<const int64_t> forgotten);
  // The same, of rows that were nobody's when the file was opened, since the end before was none.
  // Looks at some hundred rows with each call.
  std::vector<int64_t> Sweep(SQLite::Database& database);

  // Tiles that could not be read since the last call, a line each.
  std::vector<std::string> TakeProblems();

  // Opens the connection, so that tiles can be read whatever becomes of the name of the file.
  void Connect();
  // Closes it until a tile is read again, from `path`.
  void Disconnect(std::string path);
  // The file of that name may be another from now on: no connection to it is opened any more.
  void Part();
  // From now on nobody deletes rows.
  void End();

 private:
  class Connection;

  const ControlLimits limits_;
  Mutex reading_mutex_;
  std::string path_ ABSL_GUARDED_BY(reading_mutex_);
  std::unique_ptr<Connection> connection_ ABSL_GUARDED_BY(reading_mutex_);
  bool may_connect_ ABSL_GUARDED_BY(reading_mutex_) = true;
  std::vector<std::string> problems_ ABSL_GUARDED_BY(reading_mutex_);
  Mutex mutex_;  // taken by who frees a tile, anywhere
  bool has_ended_ ABSL_GUARDED_BY(mutex_) = false;
  int64_t last_number_ ABSL_GUARDED_BY(mutex_) = 0;
  // Of the thread that writes.
  int64_t num_rows_ = 0;
  absl::flat_hash_set<int64_t> in_use_;  // when the file was opened
  int64_t to_sweep_ = 0;                 // rows
  int64_t swept_up_to_ = 0;
  int64_t sweep_end_ = 0;
  std::vector<int64_t> forgotten_ ABSL_GUARDED_BY(mutex_);
};

// Reads rows by their numbers.
class TileReader {
 public:
  TileReader(SQLite::Database& database, ControlLimits limits);
  ~TileReader();
  // NotFound where there is none of that number; DataLoss where its TileChecksum() is not this one,
  // unless that is 0.
  absl::StatusOr<Tile> Read(int64_t number, uint64_t tile_checksum);

 private:
  const ControlLimits limits_;
  std::unique_ptr<SQLite::Statement> select_;
};

// Writes trees, in one transaction.
class TreeWriter {
 public:
  TreeWriter(TileRows& rows, SQLite::Database& database);
  ~TreeWriter();

  // What `now` has other than `before`, which tree `tree` is in the database, but for the tiles
  // that are `left_out`. Rows are written in the name of `layer`. Returns how many could not be
  // read where they are.
  int64_t Write(int64_t tree, int64_t layer, const TileTree& before, const TileTree& now,
                const std::set<TileKey>& left_out);
  // All squares of trees that are not among these.
  void DeleteOtherTrees(absl::Span<const int64_t> trees);

  // Tiles that have a row now, and its number, which they are to be told after the transaction.
  using Numbers = absl::flat_hash_map<std::shared_ptr<const StoredTile>, int64_t>;
  int64_t num_written() const { return std::ssize(numbers_); }
  Numbers TakeNumbers() { return std::move(numbers_); }

 private:
  struct Statements;

  // 0 where the content cannot be read.
  int64_t NumberOf(TileKey key, int64_t layer, const TileTree::Entry& entry);

  TileRows& rows_;
  std::unique_ptr<Statements> statements_;
  Numbers numbers_;
};

}  // namespace splinemap
