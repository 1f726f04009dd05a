#pragma once

#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "lib/base/mutex.h"
#include "lib/tiles/tile_memory.h"
#include "splinemap/tile_tree.h"

namespace splinemap {

// Takes tiles that are in no map file yet, so that they can leave memory: a file without a name,
// which ends with its last tile. Thread-safe.
class SpillFile : public TileSource {
 public:
  // In `folder`. Unavailable where nothing can be written there.
  static absl::StatusOr<std::shared_ptr<SpillFile>> Make(const std::string& folder,
                                                         std::shared_ptr<TileMemory> memory);
  ~SpillFile() override;

  // Takes the tiles of a tree that changed since its version `since` and have no source. Where the
  // disk is full they stay in memory.
  static void Take(const std::shared_ptr<SpillFile>& file, const TileTree& tiles, uint64_t since);

  std::shared_ptr<const Tile> Load(int64_t number, uint64_t checksum) override;
  void Forget(int64_t number) override;

  // Whether a tile could not be read back.
  bool has_lost_tiles() const { return has_lost_tiles_; }

 private:
  SpillFile(int descriptor, std::shared_ptr<TileMemory> memory)
      : TileSource(std::move(memory)), descriptor_(descriptor) {}

  const int descriptor_;
  std::atomic<bool> has_lost_tiles_{false};
  Mutex mutex_;
  int64_t slots_ ABSL_GUARDED_BY(mutex_) = 0;
  std::vector<int64_t> free_ ABSL_GUARDED_BY(mutex_);
};

}  // namespace splinemap
