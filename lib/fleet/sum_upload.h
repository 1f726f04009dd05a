#pragma once

#include <cstdint>
#include <map>
#include <set>

#include "absl/status/status.h"
#include "lib/base/clock.h"
#include "lib/fleet/fleet_key.h"
#include "lib/fleet/fleet_store.h"
#include "lib/fleet/query_tiles.h"
#include "splinemap/map_view.h"

namespace splinemap {

// Makes a bucket of sums (README.md) have what a map has in some parts: compares the hashes of
// blocks and writes those that differ, whatever the reason. Thread-compatible.
class SumUpload {
 public:
  // `store` outlives it.
  explicit SumUpload(FleetStore& store) : store_(store) {}

  // Of `map`, which is complete in `parts`; what the bucket has of others is not touched. After an
  // error it has some of it, and each block is right; call it again. Costs what changed since the
  // last call; all of the parts when the bucket was made anew, and once a minute.
  absl::Status Bring(const MapView& map, const PartSet& parts);

  int64_t blocks() const { return blocks_; }  // written

 private:
  absl::Status Compare(const PartSet& parts);
  absl::Status WriteBlocks();

  FleetStore& store_;
  uint64_t connections_ = 0;               // of the store, when parts were compared
  Clock::time_point compared_at_;          // the first of them
  PartSet compared_;                       // in_store_ says what the bucket has of them
  std::map<BlockKey, uint64_t> in_store_;  // hashes
  TileTree tiles_;                         // of the last call
  std::set<BlockKey> dirty_;               // may differ from the bucket's
  int64_t blocks_ = 0;
};

}  // namespace splinemap
