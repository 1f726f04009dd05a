#include "lib/store/tile_rows.h"

#include <SQLiteCpp/SQLiteCpp.h>
#include <sqlite3.h>
#include <xxhash.h>

#include <algorithm>
#include <array>
#include <limits>
#include <set>

#include "lib/base/status.h"
#include "lib/layers/validity.h"
#include "lib/store/records.pb.h"
#include "lib/tiles/tile_codec.h"

namespace splinemap {
namespace {

constexpr int32_t kSquareSide = 8;  // tiles
constexpr int32_t kSquareShift = 4;

// SQLite's integers are signed.
int64_t ToSigned(uint64_t value) { return static_cast<int64_t>(value); }
uint64_t ToUnsigned(int64_t value) { return static_cast<uint64_t>(value); }

struct Square {
  int32_t x;
  int32_t y;
  auto operator<=>(const Square&) const = default;

  TileKey Child(uint32_t child) const {
    return {kSquareSide * x - kSquareShift + static_cast<int32_t>(child % kSquareSide),
            kSquareSide * y - kSquareShift + static_cast<int32_t>(child / kSquareSide)};
  }
};

Square SquareOf(TileKey key) { return {PlaceInSquares(key.tx), PlaceInSquares(key.ty)}; }

}  // namespace

void GuardConnection(SQLite::Database& database) {
  constexpr int kMaxRowBytes = 1 << 20;
  database.exec("PRAGMA trusted_schema = OFF");
  database.exec("PRAGMA cell_size_check = ON");
  sqlite3_limit(database.getHandle(), SQLITE_LIMIT_LENGTH, kMaxRowBytes);
}

uint64_t ChecksumOfRow(uint64_t tile_checksum, int64_t layer_row, uint64_t revision) {
  const std::array<uint64_t, 2> row{ToUnsigned(layer_row), revision};
  return XXH3_64bits_withSeed(row.data(), sizeof row, tile_checksum);
}

std::optional<TileKey> KeyOf(int64_t tx, int64_t ty) {
  const TileKey key{static_cast<int32_t>(tx), static_cast<int32_t>(ty)};
  if (key.tx != tx || key.ty != ty || !IsInRange(key)) return std::nullopt;
  return key;
}

absl::StatusOr<Tile> TileOfRow(const TileRow& row, TileKey key, ControlLimits limits) {
  const absl::StatusOr<Tile> decoded = DecodeTile(row.content);
  if (!decoded.ok()) {
    return DataLoss("tile ({}, {}) cannot be read: {}", key.tx, key.ty,
                    ErrorText(decoded.status()));
  }
  const Tile& tile = *decoded;
  const uint64_t checksum = TileChecksum(key, tile);
  if (row.checksum != ChecksumOfRow(checksum, row.layer, row.revision) &&
      row.checksum != checksum) {  // in files of schema 2 it is the tile's alone
    return DataLoss("tile ({}, {}) does not match its checksum", key.tx, key.ty);
  }
  SPLINEMAP_RETURN_IF_ERROR(CheckTile(key, tile, limits));
  return tile;
}

uint64_t ChecksumOfSquare(int64_t tree, int64_t x, int64_t y, const std::string& content) {
  const std::array<int64_t, 3> place{tree, x, y};
  return XXH3_64bits_withSeed(content.data(), content.size(),
                              XXH3_64bits(place.data(), sizeof place));
}

absl::StatusOr<std::vector<SquareEntry>> EntriesOfSquare(int64_t tree, int64_t x, int64_t y,
                                                         const std::string& content,
                                                         uint64_t checksum) {
  store::SquareRecord record;
  constexpr int64_t kMost = (kMaxKnotIndex >> 5) / kSquareSide + 1;
  const auto is_within = [](int64_t place) { return place >= -kMost && place <= kMost; };
  const bool is_place = is_within(x) && is_within(y);
  const int tiles = ChecksumOfSquare(tree, x, y, content) == checksum && is_place &&
                            record.ParseFromString(content)
                        ? record.child_size()
                        : -1;
  if (tiles < 0 || tiles != record.number_size() || tiles != record.revision_size() ||
      tiles != record.checksum_size() || tiles != record.touched_size()) {
    return DataLoss("square ({}, {}) cannot be read", x, y);
  }
  const Square square{static_cast<int32_t>(x), static_cast<int32_t>(y)};
  std::vector<SquareEntry> entries;
  entries.reserve(tiles);
  for (int k = 0; k < tiles; ++k) {
    const SquareEntry entry{square.Child(record.child(k) % 64), record.number(k),
                            record.revision(k), record.checksum(k),
                            TouchedPoints::Unpacked(record.touched(k))};
    if (IsInRange(entry.key)) entries.push_back(entry);
  }
  return entries;
}

TileReader::TileReader(SQLite::Database& database, ControlLimits limits)
    : limits_(limits),
      select_(std::make_unique<SQLite::Statement>(
          database,
          "SELECT layer, tx, ty, revision, checksum, content FROM tile WHERE number = ?")) {}
TileReader::~TileReader() = default;

absl::StatusOr<Tile> TileReader::Read(int64_t number, uint64_t tile_checksum) {
  SQLite::Statement& select = *select_;
  select.reset();
  select.bind(1, number);
  if (!select.executeStep()) return NotFound("tile {} is missing", number);
  const TileRow row{number,
                    select.getColumn(0).getInt64(),
                    select.getColumn(1).getInt64(),
                    select.getColumn(2).getInt64(),
                    ToUnsigned(select.getColumn(3).getInt64()),
                    ToUnsigned(select.getColumn(4).getInt64()),
                    select.getColumn(5).getString()};
  select.reset();
  const std::optional<TileKey> key = KeyOf(row.tx, row.ty);
  if (!key) return DataLoss("tile ({}, {}) cannot be", row.tx, row.ty);
  SPLINEMAP_ASSIGN_OR_RETURN(const Tile tile, TileOfRow(row, *key, limits_));
  if (tile_checksum != 0 && TileChecksum(*key, tile) != tile_checksum) {
    return DataLoss("tile ({}, {}) is another", key->tx, key->ty);
  }
  return tile;
}

class TileRows::Connection {
 public:
  Connection(const std::string& path, ControlLimits limits)
      : database_(path, SQLite::OPEN_READONLY, /*aBusyTimeoutMs=*/5000),
        reader_((GuardConnection(database_), database_), limits) {}

  absl::StatusOr<Tile> Read(int64_t number, uint64_t checksum) {
    return reader_.Read(number, checksum);
  }

 private:
  SQLite::Database database_;
  TileReader reader_;
};

TileRows::TileRows(std::string path, ControlLimits limits, std::shared_ptr<TileMemory> memory)
    : TileSource(std::move(memory)), limits_(limits), path_(std::move(path)) {}
TileRows::~TileRows() = default;

std::shared_ptr<const Tile> TileRows::Load(int64_t number, uint64_t checksum) {
  MutexLock lock(reading_mutex_);
  std::string problem;
  try {
    if (!connection_ && may_connect_) connection_ = std::make_unique<Connection>(path_, limits_);
    const absl::StatusOr<Tile> tile =
        connection_ ? connection_->Read(number, checksum) : NotFound("the file is gone");
    if (tile.ok()) return std::make_shared<const Tile>(*tile);
    problem = ErrorText(tile.status());
  } catch (const SQLite::Exception& exception) {
    problem = exception.what();
  }
  constexpr size_t kMaxProblems = 100;
  if (problems_.size() < kMaxProblems) problems_.push_back(fmt::format("{}: {}", path_, problem));
  return nullptr;
}

void TileRows::Forget(int64_t number) {
  MutexLock lock(mutex_);
  if (!has_ended_) forgotten_.push_back(number);
}

int64_t TileRows::NewNumber() {
  MutexLock lock(mutex_);
  return ++last_number_;
}

void TileRows::BeginWith(int64_t last_number, int64_t num_rows,
                         absl::flat_hash_set<int64_t> in_use) {
  {
    MutexLock lock(mutex_);
    last_number_ = last_number;
  }
  num_rows_ = num_rows;
  to_sweep_ = num_rows - std::ssize(in_use);
  sweep_end_ = last_number;
  if (to_sweep_ > 0) in_use_ = std::move(in_use);
}

std::vector<int64_t> TileRows::Sweep(SQLite::Database& database) {
  constexpr int kRowsAtOnce = 256;
  std::vector<int64_t> unused;
  if (to_sweep_ <= 0) return unused;
  SQLite::Statement rows(database,
                         "SELECT number FROM tile WHERE number > ? AND number <= ? ORDER BY number "
                         "LIMIT ?");
  rows.bind(1, swept_up_to_);
  rows.bind(2, sweep_end_);
  rows.bind(3, kRowsAtOnce);
  int count = 0;
  while (rows.executeStep()) {
    ++count;
    swept_up_to_ = rows.getColumn(0).getInt64();
    if (!in_use_.contains(swept_up_to_)) unused.push_back(swept_up_to_);
  }
  to_sweep_ = count < kRowsAtOnce ? 0 : to_sweep_ - std::ssize(unused);
  if (to_sweep_ <= 0) in_use_ = {};
  return unused;
}

std::vector<int64_t> TileRows::TakeForgotten(size_t max_numbers) {
  MutexLock lock(mutex_);
  const auto begin = forgotten_.end() - std::min(max_numbers, forgotten_.size());
  std::vector<int64_t> taken(begin, forgotten_.end());
  forgotten_.erase(begin, forgotten_.end());
  return taken;
}

void TileRows::GiveBack(absl::Span<const int64_t> forgotten) {
  MutexLock lock(mutex_);
  forgotten_.insert(forgotten_.end(), forgotten.begin(), forgotten.end());
}

std::vector<std::string> TileRows::TakeProblems() {
  MutexLock lock(reading_mutex_);
  return std::exchange(problems_, {});
}

void TileRows::Connect() {
  MutexLock lock(reading_mutex_);
  try {
    if (!connection_) connection_ = std::make_unique<Connection>(path_, limits_);
    connection_->Read(0, 0).IgnoreError();  // opens the files beside as well
  } catch (const SQLite::Exception&) {      // who reads a tile will see
  }
}

void TileRows::Disconnect(std::string path) {
  MutexLock lock(reading_mutex_);
  path_ = std::move(path);
  connection_.reset();
}

void TileRows::Part() {
  MutexLock lock(reading_mutex_);
  may_connect_ = false;
}

void TileRows::End() {
  MutexLock lock(mutex_);
  has_ended_ = true;
  forgotten_ = {};
}

struct TreeWriter::Statements {
  explicit Statements(SQLite::Database& database)
      : put_tile(database,
                 "INSERT INTO tile (number, layer, tx, ty, revision, checksum, content) VALUES "
                 "(?, ?, ?, ?, ?, ?, ?)"),
        put_square(database,
                   "INSERT OR REPLACE INTO tile_square (tree, x, y, content, checksum) VALUES "
                   "(?, ?, ?, ?, ?)"),
        remove_square(database, "DELETE FROM tile_square WHERE tree = ? AND x = ? AND y = ?"),
        next_tree(database, "SELECT min(tree) FROM tile_square WHERE tree > ?"),
        remove_tree(database, "DELETE FROM tile_square WHERE tree = ?") {}

  SQLite::Statement put_tile, put_square, remove_square, next_tree, remove_tree;
};

TreeWriter::TreeWriter(TileRows& rows, SQLite::Database& database)
    : rows_(rows), statements_(std::make_unique<Statements>(database)) {}
TreeWriter::~TreeWriter() = default;

int64_t TreeWriter::NumberOf(TileKey key, int64_t layer, const TileTree::Entry& entry) {
  if (const int64_t number = entry.tile->NumberAt(&rows_); number != 0) return number;
  const auto found = numbers_.find(entry.tile);
  if (found != numbers_.end()) return found->second;
  const std::shared_ptr<const Tile> tile = entry.tile->TryGet();
  if (tile == nullptr) return 0;
  const int64_t number = numbers_[entry.tile] = rows_.NewNumber();
  const std::string content = EncodeTile(*tile);
  SQLite::Statement& put = statements_->put_tile;
  put.bind(1, number);
  put.bind(2, layer);
  put.bind(3, key.tx);
  put.bind(4, key.ty);
  put.bind(5, ToSigned(entry.revision));
  put.bind(6, ToSigned(ChecksumOfRow(entry.tile->Checksum(key), layer, entry.revision)));
  put.bind(7, content.data(), static_cast<int>(content.size()));
  put.exec();
  put.reset();
  return number;
}

int64_t TreeWriter::Write(int64_t tree, int64_t layer, const TileTree& before, const TileTree& now,
                          const std::set<TileKey>& left_out) {
  int64_t unreadable = 0;
  std::set<Square> changed;
  TileTree::ForEachDifference(before, now,
                              [&](TileKey key, const TileTree::Entry*, const TileTree::Entry*) {
                                changed.insert(SquareOf(key));
                              });
  for (const Square& square : changed) {
    store::SquareRecord record;
    for (uint32_t child = 0; child < kSquareSide * kSquareSide; ++child) {
      const TileKey key = square.Child(child);
      if (!IsInRange(key) || left_out.contains(key)) continue;
      const std::shared_ptr<const StoredTile> tile = now.Share(key);
      if (tile == nullptr) continue;
      const uint64_t revision = now.RevisionOf(key);
      const int64_t number = NumberOf(key, layer, {tile, revision});
      if (number == 0) {
        ++unreadable;
        continue;
      }
      record.add_child(child);
      record.add_number(number);
      record.add_revision(revision);
      record.add_checksum(tile->Checksum(key));
      record.add_touched(tile->Touched().Packed());
    }
    SQLite::Statement& statement =
        record.child_size() == 0 ? statements_->remove_square : statements_->put_square;
    statement.bind(1, tree);
    statement.bind(2, square.x);
    statement.bind(3, square.y);
    const std::string content = record.SerializeAsString();
    if (record.child_size() > 0) {
      statement.bind(4, content.data(), static_cast<int>(content.size()));
      statement.bind(5, ToSigned(ChecksumOfSquare(tree, square.x, square.y, content)));
    }
    statement.exec();
    statement.reset();
  }
  return unreadable;
}

void TreeWriter::DeleteOtherTrees(absl::Span<const int64_t> trees) {
  int64_t tree = std::numeric_limits<int64_t>::min();
  while (true) {
    SQLite::Statement& next = statements_->next_tree;
    next.bind(1, tree);
    const bool is_there = next.executeStep() && !next.getColumn(0).isNull();
    if (is_there) tree = next.getColumn(0).getInt64();
    next.reset();
    if (!is_there) return;
    if (std::find(trees.begin(), trees.end(), tree) != trees.end()) continue;
    statements_->remove_tree.bind(1, tree);
    statements_->remove_tree.exec();
    statements_->remove_tree.reset();
  }
}

}  // namespace splinemap
