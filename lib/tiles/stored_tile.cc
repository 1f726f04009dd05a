#include "splinemap/stored_tile.h"

#include <thread>
#include <utility>

#include "lib/base/read_section.h"
#include "lib/tiles/tile_codec.h"
#include "lib/tiles/tile_memory.h"

namespace splinemap {

namespace {

constexpr uint32_t kIsKnown = uint32_t{1} << 31;

}  // namespace

class StoredTile::Guard {
 public:
  explicit Guard(const StoredTile& tile) : tile_(tile) {
    while (tile_.is_locked_.exchange(true, std::memory_order_acquire)) std::this_thread::yield();
  }
  ~Guard() { tile_.is_locked_.store(false, std::memory_order_release); }
  Guard(const Guard&) = delete;
  Guard& operator=(const Guard&) = delete;

 private:
  const StoredTile& tile_;
};

StoredTile::StoredTile(std::shared_ptr<TileSource> source, int64_t number)
    : source_(std::move(source)), number_(number) {}

StoredTile::StoredTile(std::shared_ptr<TileSource> source, int64_t number, uint64_t checksum,
                       const TouchedPoints& touched)
    : source_(std::move(source)),
      number_(number),
      checksum_(checksum),
      touched_(kIsKnown | touched.Packed()) {}

StoredTile::~StoredTile() {
  if (is_counted_) source_->memory()->Remove();
  if (source_) source_->Forget(number_);
}

std::shared_ptr<const Tile> StoredTile::Get() const {
  static const auto kUnreadable = std::make_shared<const Tile>();
  std::shared_ptr<const Tile> tile = TryGet();
  return tile == nullptr ? kUnreadable : tile;
}

std::shared_ptr<const Tile> StoredTile::TryGet() const {
  std::shared_ptr<const Tile> tile;
  std::shared_ptr<TileSource> source;
  {
    const Guard guard(*this);
    was_used_ = tile_ != nullptr;  // once is not used again
    if (tile_) return tile_;
    source = source_;
    tile = source->Load(number_, checksum_.load(std::memory_order_relaxed));
    if (tile == nullptr) return nullptr;
    tile_ = tile;
    content_.store(tile.get(), std::memory_order_release);
    is_counted_ = source->memory() != nullptr;
    if (is_counted_) source->memory()->Count();
  }
  if (source->memory() != nullptr) source->memory()->Add(weak_from_this());
  return tile;
}

Tile& StoredTile::Edit() {
  if (!is_own_ || tile_.use_count() > 1) {
    tile_ = std::make_shared<Tile>(*tile_);
    is_own_ = true;
    content_.store(tile_.get(), std::memory_order_relaxed);
  }
  // Nobody else has this object, and who gets it sees all that was written before.
  checksum_.store(0, std::memory_order_relaxed);
  touched_.store(0, std::memory_order_relaxed);
  is_settled_known_.store(false, std::memory_order_relaxed);
  return const_cast<Tile&>(*tile_);
}

uint64_t StoredTile::Checksum(TileKey key) const {
  uint64_t checksum = checksum_.load(std::memory_order_relaxed);
  if (checksum == 0) {
    checksum = TileChecksum(key, *Get());
    checksum_.store(checksum, std::memory_order_relaxed);
  }
  return checksum;
}

TouchedPoints StoredTile::Touched() const {
  uint32_t packed = touched_.load(std::memory_order_relaxed);
  if (packed == 0) {
    packed = kIsKnown | TouchedPointsOf(*Get()).Packed();
    touched_.store(packed, std::memory_order_relaxed);
  }
  return TouchedPoints::Unpacked(packed);
}

TileCells StoredTile::FindSettledCells() const {
  std::shared_ptr<const Tile> tile;
  {
    const Guard guard(*this);
    tile = tile_;
  }
  if (tile == nullptr) return 0;
  const TileCells cells = SettledCellsOf(*tile);
  settled_.store(cells, std::memory_order_relaxed);
  is_settled_known_.store(true, std::memory_order_release);
  return cells;
}

bool StoredTile::HasSource() const {
  const Guard guard(*this);
  return source_ != nullptr;
}

int64_t StoredTile::NumberAt(const TileSource* source) const {
  const Guard guard(*this);
  return source_.get() == source ? number_ : 0;
}

void StoredTile::SetSource(std::shared_ptr<TileSource> source, int64_t number) const {
  SetSource(std::move(source), number, false);
}

bool StoredTile::SetFirstSource(std::shared_ptr<TileSource> source, int64_t number) const {
  return SetSource(std::move(source), number, true);
}

bool StoredTile::SetSource(std::shared_ptr<TileSource> source, int64_t number,
                           bool only_first) const {
  const std::shared_ptr<TileSource> now = source;
  bool is_added = false;
  {
    const Guard guard(*this);
    if (only_first && source_) return false;
    if (std::exchange(is_counted_, false)) source_->memory()->Remove();
    source_.swap(source);
    std::swap(number_, number);
    is_counted_ = is_added = now->memory() != nullptr && tile_ != nullptr;
    if (is_counted_) now->memory()->Count();
  }
  if (source) source->Leave(number);
  if (is_added) now->memory()->Add(weak_from_this());
  return true;
}

bool StoredTile::IsCounted() const {
  const Guard guard(*this);
  return is_counted_;
}

StoredTile::Eviction StoredTile::Evict() const {
  if (is_locked_.exchange(true, std::memory_order_acquire)) return Eviction::kWasUsed;
  std::shared_ptr<const Tile> gone;
  Eviction eviction = Eviction::kNothingToDo;
  if (is_counted_) {
    eviction = was_used_.exchange(false) ? Eviction::kWasUsed : Eviction::kDone;
  }
  if (eviction == Eviction::kDone) {
    content_ = nullptr;
    gone = std::move(tile_);
    is_counted_ = false;
    source_->memory()->Remove();
  }
  is_locked_.store(false, std::memory_order_release);
  if (gone) {
    // After nobody finds it any more, and before it is retired: so a section that reads the count of
    // before began early enough to keep it.
    num_evictions_.fetch_add(1);
    ReadSection::Retire(std::move(gone));
  }
  return eviction;
}

bool HaveEqualContent(const StoredTile& a, const StoredTile& b) {
  return &a == &b || *a.Get() == *b.Get();
}

void TileMemory::SetMaxTiles(size_t max_tiles) {
  max_tiles_ = max_tiles;
  MutexLock lock(mutex_);
  Shrink();
}

void TileMemory::Add(std::weak_ptr<const StoredTile> tile) {
  MutexLock lock(mutex_);
  tiles_.push_back(std::move(tile));
  Shrink();
}

// Beyond the bound tiles go; else only the places in the row of those that went otherwise.
void TileMemory::Shrink() {
  const bool is_over = num_tiles_ > max_tiles_;
  if (!is_over && tiles_.size() <= 2 * num_tiles_ + 1024) return;
  size_t left = is_over ? 2 * tiles_.size() : tiles_.size();  // each has its second chance
  while (!tiles_.empty() && left-- > 0 && (!is_over || num_tiles_ > max_tiles_)) {
    const std::shared_ptr<const StoredTile> oldest = tiles_.front().lock();
    const bool stays =
        oldest != nullptr &&
        (is_over ? oldest->Evict() == StoredTile::Eviction::kWasUsed : oldest->IsCounted());
    if (stays) tiles_.push_back(tiles_.front());
    tiles_.pop_front();
  }
}

}  // namespace splinemap
