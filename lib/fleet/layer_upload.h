#pragma once

#include <cstdint>
#include <map>
#include <optional>
#include <set>
#include <string>

#include "absl/functional/function_ref.h"
#include "absl/status/status.h"
#include "lib/base/clock.h"
#include "lib/fleet/fleet_key.h"
#include "lib/fleet/fleet_store.h"
#include "lib/fleet/layer_block.h"
#include "lib/fleet/layer_digest.h"
#include "splinemap/layer_set.h"

namespace splinemap {

// Makes a bucket have what a layer has: compares the hashes of blocks and writes those that differ,
// whatever the reason, and then a digest of all. So nothing is sent twice, what the engine forgot
// is written again, and after days without a connection it costs what differs. Thread-compatible.
class LayerUpload {
 public:
  // `store` outlives it.
  LayerUpload(FleetStore& store, LayerId id, const MapOptions& options);

  // Waits until so many bytes may be sent; false where the upload is to end.
  using Pace = absl::FunctionRef<bool(int64_t bytes)>;

  // Writes what `layer` has other than the bucket; OK when it has all of it, and its digest. After
  // an error, and where Pace says so, it has a part, which is right block by block; call it again.
  // FailedPrecondition where the bucket has a greater session: see greater_session().
  absl::Status Bring(const LayerSnapshot& layer, Pace pace);

  // Looks whether nothing was written after the digest, and it is there, and else has the next
  // Bring() compare everything where it is not. Call it now and then.
  absl::Status Look();
  // Has the next Bring() compare everything.
  void CompareAgain() {
    is_compared_ = false;
    is_to_list_ = true;
  }

  // Of the bucket, where Bring() was refused for it.
  std::optional<SessionId> greater_session() const { return greater_session_; }

  struct Counts {
    int64_t blocks = 0;   // written
    int64_t digests = 0;  // the same
    int64_t bytes = 0;    // the same, values alone
    int64_t listed = 0;   // how often all hashes were read
  };
  const Counts& counts() const { return counts_; }

 private:
  absl::Status Compare(const LayerSnapshot& layer);
  absl::Status ReadDigest();
  absl::Status List();
  absl::Status CheckConnection();
  void SumDirtyBlocks();
  LayerDigest DigestOf(const LayerSnapshot& layer) const;
  absl::Status WriteBlocks(const LayerSnapshot& layer, Pace pace);
  absl::Status WriteDigest(LayerDigest digest);

  FleetStore& store_;
  const LayerId id_;
  const MapOptions options_;
  bool is_compared_ = false;
  bool is_to_list_ = false;                // whatever the digest says
  uint64_t connections_ = 0;               // of the store, when everything was compared
  std::map<BlockKey, uint64_t> in_store_;  // hashes of blocks
  uint64_t digest_revision_ = 0;           // of its entry; 0: there is none
  uint64_t digest_hash_ = 0;
  std::optional<SessionId> session_in_store_;
  std::optional<SessionId> greater_session_;
  TileTree tiles_;                            // of the last snapshot
  std::set<BlockKey> dirty_;                  // may differ from the bucket's
  std::map<BlockKey, LayerBlock::Sum> sums_;  // of tiles_
  Counts counts_;
};

}  // namespace splinemap
