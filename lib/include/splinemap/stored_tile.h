#pragma once

#include <atomic>
#include <cstdint>
#include <memory>

#include "splinemap/tile.h"

namespace splinemap {

class ReadSection;
class TileSource;

// A tile of a tree: in memory, or wherever its source has it until somebody asks. Shared by all
// trees that have it. Thread-safe but for Edit().
class StoredTile : public std::enable_shared_from_this<StoredTile> {
 public:
  // In memory, for as long as it has no source. The first is a tile of zeros.
  StoredTile() : StoredTile(Tile()) {}
  explicit StoredTile(const Tile& tile)
      : tile_(std::make_shared<Tile>(tile)), content_(tile_.get()), is_own_(true) {}
  // At the source, which knows it by that number.
  StoredTile(std::shared_ptr<TileSource> source, int64_t number);
  // The same, where it is known what the functions of these names say.
  StoredTile(std::shared_ptr<TileSource> source, int64_t number, uint64_t checksum,
             const TouchedPoints& touched);
  // In memory, a copy of its own.
  StoredTile(const StoredTile& other)
      : enable_shared_from_this(), tile_(other.Get()), content_(tile_.get()) {}
  StoredTile& operator=(const StoredTile&) = delete;
  ~StoredTile();

  // The content, which stays in memory for as long as the caller has it; zeros where it cannot be
  // read, which its source tells, and which is tried again with the next call.
  std::shared_ptr<const Tile> Get() const;
  // The same for as long as the section; faster, for the library's own queries.
  const Tile& Read(const ReadSection&) const {
    const Tile* const content = ContentInMemory();
    return content != nullptr ? *content : *Get();
  }
  // How many contents have left memory in this process. What Read() gave is there for a section
  // that began before it read the same number, too.
  static uint64_t NumEvictions() { return num_evictions_.load(std::memory_order_acquire); }
  // Null where it cannot be read. For those who write what they make of it.
  std::shared_ptr<const Tile> TryGet() const;
  const Tile* TryRead(const ReadSection&) const {
    const Tile* const content = ContentInMemory();
    return content != nullptr ? content : TryGet().get();
  }
  // The content to be written. Requires that it has no source, and that nobody else has this
  // object.
  Tile& Edit();

  // TileChecksum() of the content, for `key`, with which it is always called.
  uint64_t Checksum(TileKey key) const;
  TouchedPoints Touched() const;
  // SettledCellsOf() the content; none where it is not in memory and they are not known.
  TileCells SettledCells() const {
    return is_settled_known_.load(std::memory_order_acquire)
               ? settled_.load(std::memory_order_relaxed)
               : FindSettledCells();
  }
  // From who has edited it, and knows. Requires what Edit() does.
  void SetSettledCells(TileCells cells) {
    settled_.store(cells, std::memory_order_relaxed);
    is_settled_known_.store(true, std::memory_order_relaxed);
  }

  bool HasSource() const;
  // The number at `source`; 0 where it has another source or none.
  int64_t NumberAt(const TileSource* source) const;
  // From now on it may leave memory, and comes back from there. Requires a number other than 0 that
  // is its alone.
  void SetSource(std::shared_ptr<TileSource> source, int64_t number) const;
  // False where it has a source already, and keeps that.
  bool SetFirstSource(std::shared_ptr<TileSource> source, int64_t number) const;

 private:
  friend class TileMemory;
  class Guard;

  bool SetSource(std::shared_ptr<TileSource> source, int64_t number, bool only_first) const;
  // Null where it is not there.
  const Tile* ContentInMemory() const {
    const Tile* const content = content_.load(std::memory_order_acquire);
    if (content != nullptr && !was_used_.load(std::memory_order_relaxed)) {
      was_used_.store(true, std::memory_order_relaxed);
    }
    return content;
  }
  TileCells FindSettledCells() const;
  bool IsCounted() const;
  enum class Eviction { kDone, kWasUsed, kNothingToDo };
  Eviction Evict() const;

  static inline std::atomic<uint64_t> num_evictions_{0};

  mutable std::shared_ptr<const Tile> tile_;  // null where it is at the source
  mutable std::shared_ptr<TileSource> source_;
  mutable int64_t number_ = 0;
  mutable std::atomic<uint64_t> checksum_{0};  // 0: to be found
  mutable std::atomic<uint32_t> touched_{0};   // packed; 0: to be found
  mutable std::atomic<TileCells> settled_{0};
  mutable std::atomic<bool> is_settled_known_{false};  // else to be found
  mutable std::atomic<bool> is_locked_{false};         // guards all above
  mutable std::atomic<const Tile*> content_{nullptr};  // what tile_ has, for readers without a lock
  mutable std::atomic<bool> was_used_{false};
  mutable bool is_counted_ = false;  // by the source's memory
  bool is_own_ = false;              // tile_ was made here
};

// Without reading what is the same object.
bool HaveEqualContent(const StoredTile& a, const StoredTile& b);

}  // namespace splinemap
