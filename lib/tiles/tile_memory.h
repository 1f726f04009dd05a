#pragma once

#include <atomic>
#include <cstddef>
#include <cstdint>
#include <deque>
#include <memory>

#include "lib/base/mutex.h"
#include "splinemap/stored_tile.h"

namespace splinemap {

// Bounds how many tiles are in memory that their sources could bring back: beyond, those go that
// were not used for longest, by second chance. Thread-safe.
class TileMemory {
 public:
  // What a tile takes in memory.
  static constexpr size_t kBytesPerTile = sizeof(Tile) + 64;

  explicit TileMemory(size_t max_tiles) : max_tiles_(max_tiles) {}

  void SetMaxTiles(size_t max_tiles);
  size_t max_tiles() const { return max_tiles_; }
  size_t num_tiles() const { return num_tiles_; }

 private:
  friend class StoredTile;

  // One tile more is in memory, or less.
  void Count() { ++num_tiles_; }
  void Remove() { --num_tiles_; }
  // It may go.
  void Add(std::weak_ptr<const StoredTile> tile);
  void Shrink() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);

  std::atomic<size_t> max_tiles_;
  std::atomic<size_t> num_tiles_{0};
  Mutex mutex_;
  std::deque<std::weak_ptr<const StoredTile>> tiles_ ABSL_GUARDED_BY(mutex_);  // by age
};

// Where tiles stand that are not in memory. Thread-safe.
class TileSource {
 public:
  // `memory` bounds how many of its tiles are in memory; null: nothing does, and none leaves it.
  explicit TileSource(std::shared_ptr<TileMemory> memory) : memory_(std::move(memory)) {}
  virtual ~TileSource() = default;

  // The tile of that number, with the same bytes each time; null where it cannot be read, or has
  // another TileChecksum() than that, if it is not 0. All functions are called with locks held,
  // Forget() by whoever frees a tile.
  virtual std::shared_ptr<const Tile> Load(int64_t number, uint64_t checksum) = 0;
  // Nobody has a tile of that number any more.
  virtual void Forget(int64_t /*number*/) {}
  // The tile of that number has another source now.
  virtual void Leave(int64_t number) { Forget(number); }

  TileMemory* memory() const { return memory_.get(); }

 private:
  const std::shared_ptr<TileMemory> memory_;
};

}  // namespace splinemap
