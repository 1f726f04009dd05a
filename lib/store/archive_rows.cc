#include "lib/store/archive_rows.h"

#include <SQLiteCpp/SQLiteCpp.h>
#include <xxhash.h>

#include <algorithm>
#include <array>
#include <utility>

#include "lib/base/status.h"
#include "lib/layers/validity.h"
#include "lib/tiles/tile_codec.h"

namespace splinemap {
namespace {

int64_t Signed(uint64_t value) { return static_cast<int64_t>(value); }

// Bound to the place of the row, so that no row of a damaged page is taken for another's.
uint64_t ChecksumOfRow(const std::string& content, std::array<int64_t, 3> place) {
  return XXH3_64bits_withSeed(content.data(), content.size(),
                              XXH3_64bits(place.data(), sizeof place));
}

void SetPose(const FixedPose2& pose, store::PoseRecord& record) {
  record.set_x(pose.x);
  record.set_y(pose.y);
  record.set_yaw(pose.yaw);
}

FixedPose2 PoseOf(const store::PoseRecord& record) {
  return {record.x(), record.y(), record.yaw()};
}

class BlockWriter {
 public:
  BlockWriter(int64_t archive, SQLite::Database& database)
      : archive_(archive),
        put_beams_(
            database,
            "INSERT INTO scan_beams (archive, block, content, checksum) VALUES (?, ?, ?, ?)"),
        put_poses_(database,
                   "INSERT OR REPLACE INTO scan_poses (archive, block, checksum, content) VALUES "
                   "(?, ?, ?, ?)"),
        remove_beams_(database, "DELETE FROM scan_beams WHERE archive = ? AND block = ?"),
        remove_poses_(database, "DELETE FROM scan_poses WHERE archive = ? AND block = ?") {}

  void PutBeams(int64_t block, const std::string& content) {
    put_beams_.bind(1, archive_);
    put_beams_.bind(2, block);
    put_beams_.bind(3, content.data(), static_cast<int>(content.size()));
    put_beams_.bind(4, Signed(ChecksumOfRow(content, {archive_, block, ArchiveReader::kBeams})));
    put_beams_.exec();
    put_beams_.reset();
  }

  void PutPoses(int64_t block, const std::string& content) {
    put_poses_.bind(1, archive_);
    put_poses_.bind(2, block);
    put_poses_.bind(3, Signed(ChecksumOfRow(content, {archive_, block, ArchiveReader::kPoses})));
    put_poses_.bind(4, content.data(), static_cast<int>(content.size()));
    put_poses_.exec();
    put_poses_.reset();
  }

  void Remove(int64_t block) {
    for (SQLite::Statement* remove : {&remove_beams_, &remove_poses_}) {
      remove->bind(1, archive_);
      remove->bind(2, block);
      remove->exec();
      remove->reset();
    }
  }

 private:
  const int64_t archive_;
  SQLite::Statement put_beams_, put_poses_, remove_beams_, remove_poses_;
};

// The numbers of the blocks: those that are there already keep theirs, as long as all are in order.
std::vector<int64_t> NumbersOf(const std::vector<std::shared_ptr<const ScanBlock>>& blocks,
                               const SavedArchive& saved) {
  std::map<const std::string*, int64_t> known;  // by their beams, which do not change
  for (const auto& [number, block] : saved.blocks) known[block->beams.get()] = number;
  const int64_t last = saved.blocks.empty() ? 0 : saved.blocks.rbegin()->first;
  std::vector<int64_t> numbers;
  for (const auto& block : blocks) {
    const auto found = known.find(block->beams.get());
    const int64_t before = numbers.empty() ? 0 : numbers.back();
    const bool goes_on = found != known.end() && found->second > before;
    numbers.push_back(goes_on ? found->second : std::max(before, last) + 1);
  }
  return numbers;
}

void WriteBlocks(const ScanArchive& archive, const SavedArchive& saved, SavedArchive& now,
                 SQLite::Database& database) {
  const auto blocks = archive.Blocks();
  const std::vector<int64_t> numbers = NumbersOf(blocks, saved);
  for (size_t k = 0; k < blocks.size(); ++k) now.blocks[numbers[k]] = blocks[k];
  BlockWriter writer(now.id, database);
  for (const auto& [number, block] : saved.blocks) {
    const auto kept = now.blocks.find(number);
    if (kept == now.blocks.end() || kept->second->beams != block->beams) writer.Remove(number);
  }
  for (const auto& [number, block] : now.blocks) {
    const auto before = saved.blocks.find(number);
    const bool has_beams = before != saved.blocks.end() && before->second->beams == block->beams;
    if (!has_beams) writer.PutBeams(number, *block->beams);
    if (!has_beams || before->second->poses != block->poses) writer.PutPoses(number, block->poses);
  }
}

int64_t NextArchiveId(int64_t last_id, SQLite::Database& database) {
  for (const char* table : {"scan_beams", "scan_poses"}) {
    const auto greatest =
        database.execAndGet(fmt::format("SELECT ifnull(max(archive), 0) FROM {}", table));
    last_id = std::max(last_id, greatest.getInt64());
  }
  return last_id + 1;
}

// The same tiles as a layer need no squares of their own. Once they differ they go on to.
bool IsAll(const TileTree& base, const TileTree& layer_tiles, const SavedArchive& saved) {
  const bool is_as_saved = saved.base.version() == base.version();
  if (base.size() != layer_tiles.size() || (is_as_saved && !saved.base_is_layer)) return false;
  bool is_all = true;
  TileTree::ForEachDifference(
      base, layer_tiles, [&](TileKey, const TileTree::Entry* a, const TileTree::Entry* b) {
        is_all = is_all && a != nullptr && b != nullptr && a->tile == b->tile;
      });
  return is_all;
}

}  // namespace

SavedArchive WriteArchive(const ScanArchive& archive, const TileTree& layer_tiles,
                          const SavedArchive& saved, int64_t& last_id, store::ArchiveRecord& record,
                          TreeWriter& trees, SQLite::Database& database) {
  SavedArchive now;
  now.id = saved.id != 0 ? saved.id : NextArchiveId(last_id, database);
  last_id = std::max(last_id, now.id);
  WriteBlocks(archive, saved, now, database);
  now.base = archive.base.tiles;
  now.base_is_layer = IsAll(now.base, layer_tiles, saved);
  const auto own = [](const SavedArchive& of) { return of.base_is_layer ? TileTree() : of.base; };
  trees.Write(TreeOfBase(now.id), 0, own(saved), own(now), {});

  record.set_id(now.id);
  SetPose(archive.map_T_world, *record.mutable_map_t_world());
  SetPose(archive.base.map_T_world, *record.mutable_base_map_t_world());
  record.set_base_is_layer(now.base_is_layer);
  record.set_base_tiles(now.base_is_layer ? 0 : now.base.size());
  record.set_base_scans(archive.base.scans);
  record.set_base_newest_utime(archive.base.newest.count());
  record.set_scans(archive.num_scans());
  return now;
}

void DeleteOtherArchives(const std::vector<int64_t>& ids, SQLite::Database& database) {
  for (const char* table : {"scan_beams", "scan_poses"}) {
    database.exec(
        fmt::format("DELETE FROM {} WHERE archive NOT IN ({})", table, fmt::join(ids, ", ")));
  }
}

void ArchiveReader::HandleBlock(BlockPart part, int64_t archive, int64_t block, uint64_t checksum,
                                std::string content) {
  Rows& rows = archives_[archive];
  if (checksum != ChecksumOfRow(content, {archive, block, part})) {
    ++rows.damaged;
  } else {
    rows.blocks[part][block] = std::move(content);
  }
}

void ArchiveReader::HandleBaseTile(int64_t archive, int64_t tx, int64_t ty, uint64_t checksum,
                                   const std::string& content) {
  Rows& rows = archives_[archive];
  const TileKey key{static_cast<int32_t>(tx), static_cast<int32_t>(ty)};
  const absl::StatusOr<Tile> tile = DecodeTile(content);
  if (checksum != ChecksumOfRow(content, {archive, tx, ty}) || key.tx != tx || key.ty != ty ||
      !tile.ok() || !CheckTile(key, *tile, limits_).ok()) {
    ++rows.damaged;
  } else {
    rows.base.Put(key, std::make_shared<const StoredTile>(*tile), 0);
  }
}

void ArchiveReader::AddBaseTile(int64_t archive, TileKey key,
                                std::shared_ptr<const StoredTile> tile) {
  archives_[archive].base.Put(key, std::move(tile), 0);
}

void ArchiveReader::ReadScans(SQLite::Database& database) {
  SQLite::Statement beams(database, "SELECT archive, block, content, checksum FROM scan_beams");
  while (beams.executeStep()) {
    HandleBlock(kBeams, beams.getColumn(0).getInt64(), beams.getColumn(1).getInt64(),
                static_cast<uint64_t>(beams.getColumn(3).getInt64()),
                beams.getColumn(2).getString());
  }
  SQLite::Statement poses(database, "SELECT archive, block, checksum, content FROM scan_poses");
  while (poses.executeStep()) {
    HandleBlock(kPoses, poses.getColumn(0).getInt64(), poses.getColumn(1).getInt64(),
                static_cast<uint64_t>(poses.getColumn(2).getInt64()),
                poses.getColumn(3).getString());
  }
}

void ArchiveReader::ReadBaseTable(SQLite::Database& database) {
  SQLite::Statement base(database, "SELECT archive, tx, ty, checksum, content FROM base_tile");
  while (base.executeStep()) {
    HandleBaseTile(
        base.getColumn(0).getInt64(), base.getColumn(1).getInt64(), base.getColumn(2).getInt64(),
        static_cast<uint64_t>(base.getColumn(3).getInt64()), base.getColumn(4).getString());
  }
}

ArchiveReader::Result ArchiveReader::Finish(const store::ArchiveRecord* record,
                                            const TileTree& layer_tiles) const {
  Result result;
  auto archive = std::make_shared<ScanArchive>();
  if (record == nullptr) {
    archive->base.tiles = layer_tiles;
    result.archive = std::move(archive);
    return result;
  }
  Rows rows;
  if (const auto found = archives_.find(record->id()); found != archives_.end()) {
    rows.blocks = found->second.blocks;
    rows.base = TileTreeEditor(found->second.base.tree());
    rows.damaged = found->second.damaged;
  }
  result.saved.id = record->id();
  for (auto& [number, beams] : rows.blocks[kBeams]) {
    const auto poses = rows.blocks[kPoses].find(number);
    auto block = poses == rows.blocks[kPoses].end()
                     ? absl::StatusOr<std::shared_ptr<const ScanBlock>>(DataLoss("no poses"))
                     : BlockOf(std::move(poses->second), std::move(beams));
    if (!block.ok()) {
      ++rows.damaged;
      continue;
    }
    result.saved.blocks[number] = *block;
    archive->Add(*block);
  }
  archive->map_T_world = PoseOf(record->map_t_world());
  archive->base.map_T_world = PoseOf(record->base_map_t_world());
  archive->base.scans = record->base_scans();
  archive->base.newest = Utime(record->base_newest_utime());
  archive->base.tiles = record->base_is_layer() ? layer_tiles : rows.base.Freeze();
  result.saved.base = archive->base.tiles;
  result.saved.base_is_layer = record->base_is_layer();
  if (!archive->map_T_world.IsValid() || !archive->base.map_T_world.IsValid()) {
    result.damage.push_back("its placement cannot be");
    archive->map_T_world = archive->base.map_T_world = {};
  }
  if (rows.damaged != 0 || archive->num_scans() != record->scans() ||
      (!record->base_is_layer() && archive->base.tiles.size() != record->base_tiles())) {
    result.damage.push_back(fmt::format(
        "of the {} scans that it is made of {} can be read; made anew it has those alone",
        record->scans(), archive->num_scans()));
  }
  result.archive = std::move(archive);
  return result;
}

}  // namespace splinemap
