#pragma once

#include <array>
#include <cstdint>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "lib/store/records.pb.h"
#include "lib/store/tile_rows.h"
#include "splinemap/scan_archive.h"

namespace SQLite {
class Database;
}

namespace splinemap {

// Archives of layers as rows of a database. Functions throw SQLite::Exception where SQLite fails.

inline constexpr const char* kScanTables = R"(
  CREATE TABLE scan_beams (
    archive INTEGER NOT NULL,
    block INTEGER NOT NULL,
    content BLOB NOT NULL,
    checksum INTEGER NOT NULL,
    PRIMARY KEY (archive, block)
  ) STRICT;
  CREATE TABLE scan_poses (
    archive INTEGER NOT NULL,
    block INTEGER NOT NULL,
    checksum INTEGER NOT NULL,
    content BLOB NOT NULL,
    PRIMARY KEY (archive, block)
  ) STRICT;
)";
// Of files of schema 4 and 5.
inline constexpr const char* kBaseTable = R"(
  CREATE TABLE base_tile (
    archive INTEGER NOT NULL,
    tx INTEGER NOT NULL,
    ty INTEGER NOT NULL,
    checksum INTEGER NOT NULL,
    content BLOB NOT NULL,
    PRIMARY KEY (archive, tx, ty)
  ) STRICT;
)";
// The columns of their rows: i for integer, b for bytes.
inline constexpr std::string_view kBeamsForm = "iibi";
inline constexpr std::string_view kPosesForm = "iiib";
inline constexpr std::string_view kBaseTileForm = "iiiib";

// An archive that the rows hold.
struct SavedArchive {
  int64_t id = 0;                                              // of its rows; 0: there are none
  std::map<int64_t, std::shared_ptr<const ScanBlock>> blocks;  // by their number
  TileTree base;
  bool base_is_layer = false;
};

// The tree of squares that the base of an archive is.
inline int64_t TreeOfBase(int64_t archive) { return -archive; }

// Writes what `archive` of a layer has other than `saved`, whose id it keeps, or else gets one
// greater than `last_id` and all that the rows have; `record` becomes what tells of it.
SavedArchive WriteArchive(const ScanArchive& archive, const TileTree& layer_tiles,
                          const SavedArchive& saved, int64_t& last_id, store::ArchiveRecord& record,
                          TreeWriter& trees, SQLite::Database& database);
// Deletes the rows of all archives but those with these ids.
void DeleteOtherArchives(const std::vector<int64_t>& ids, SQLite::Database& database);

// Puts archives together from rows that may be damaged.
class ArchiveReader {
 public:
  explicit ArchiveReader(ControlLimits limits) : limits_(limits) {}

  // What the two tables of blocks have.
  enum BlockPart { kBeams, kPoses };
  void HandleBlock(BlockPart part, int64_t archive, int64_t block, uint64_t checksum,
                   std::string content);
  void HandleBaseTile(int64_t archive, int64_t tx, int64_t ty, uint64_t checksum,
                      const std::string& content);
  void AddBaseTile(int64_t archive, TileKey key, std::shared_ptr<const StoredTile> tile);
  // All scans of a database, and all tiles of a base table.
  void ReadScans(SQLite::Database& database);
  void ReadBaseTable(SQLite::Database& database);

  // The archive of a layer, and what was damaged and is left out. Without a record it is what a map
  // from before there were archives has: a base.
  struct Result {
    std::shared_ptr<const ScanArchive> archive;
    std::vector<std::string> damage;
    SavedArchive saved;
  };
  Result Finish(const store::ArchiveRecord* record, const TileTree& layer_tiles) const;

 private:
  struct Rows {
    std::array<std::map<int64_t, std::string>, 2> blocks;  // by BlockPart and number
    TileTreeEditor base;
    int64_t damaged = 0;
  };
  const ControlLimits limits_;
  std::map<int64_t, Rows> archives_;
};

}  // namespace splinemap
