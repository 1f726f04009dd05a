#include "lib/fleet/layer_upload.h"

#include <algorithm>
#include <utility>
#include <vector>

#include "lib/base/host_clock.h"
#include "lib/base/status.h"
#include "lib/fleet/layer_digest.h"

namespace splinemap {
namespace {

// So many bytes are sent before what was sent is acknowledged.
constexpr int64_t kBatchBytes = 16 << 10;
// Beside the value of an entry: key, hash, and what NATS and TCP add.
constexpr int64_t kOverheadBytes = 300;

}  // namespace

LayerUpload::LayerUpload(FleetStore& store, LayerId id, const MapOptions& options)
    : store_(store), id_(std::move(id)), options_(options) {}

absl::Status LayerUpload::Bring(const LayerSnapshot& layer, Pace pace) {
  const bool is_to_compare = !is_compared_ || store_.connections() != connections_;
  if (is_to_compare) {
    sums_.clear();
    layer.tiles.ForEach(
        [&](TileKey key, const TileTree::Entry&) { dirty_.insert(BlockKey::Of(key)); });
  } else {
    TileTree::ForEachDifference(tiles_, layer.tiles,
                                [&](TileKey key, const TileTree::Entry*, const TileTree::Entry*) {
                                  dirty_.insert(BlockKey::Of(key));
                                });
  }
  tiles_ = layer.tiles;
  SumDirtyBlocks();
  if (is_to_compare) {
    SPLINEMAP_RETURN_IF_ERROR(Compare(layer));
    for (const auto& [block, hash] : in_store_) dirty_.insert(block);
  }
  greater_session_.reset();
  if (session_in_store_ && *session_in_store_ > layer.session) {
    greater_session_ = session_in_store_;
    return FailedPrecondition("the fleet has session {} of {}, which is later than {} here",
                              session_in_store_->number, id_.name, layer.session.number);
  }
  if (digest_revision_ == 0) {
    // So that a layer that takes long to arrive is shown meanwhile.
    SPLINEMAP_RETURN_IF_ERROR(
        WriteDigest({id_, layer.session, 0, 0, 0, 0, options_, {}, /*is_arriving=*/true}));
  }
  SPLINEMAP_RETURN_IF_ERROR(WriteBlocks(layer, pace));
  return WriteDigest(DigestOf(layer));
}

// What was written before the engine went away may be forgotten, and be what a digest tells of.
absl::Status LayerUpload::CheckConnection() {
  if (store_.connections() == connections_) return absl::OkStatus();
  CompareAgain();
  return Unavailable("the connection to the fleet was lost meanwhile; {} is compared again",
                     id_.name);
}

// To list all hashes costs the engine a consumer. It is spared where the entry that was written
// last is the layer's digest, so that nothing was written after it, and what it says is known.
absl::Status LayerUpload::Compare(const LayerSnapshot& layer) {
  const bool had_all = !in_store_.empty() && digest_revision_ != 0 && !is_to_list_;
  is_compared_ = false;
  const uint64_t connections = store_.connections();
  const absl::StatusOr<FleetEntry> last = store_.Get(LayerFilter(id_));
  if (!last.ok() && !absl::IsOutOfRange(last.status())) return last.status();
  const bool is_digest = last.ok() && ParseFleetKey(last->key).kind == FleetKey::Kind::kDigest;
  if (!last.ok()) {
    in_store_.clear();
    digest_revision_ = 0;
    digest_hash_ = 0;
    session_in_store_.reset();
  } else if (is_digest && had_all && last->revision == digest_revision_ &&
             last->hash == digest_hash_) {
    // It is the one that was written here last, after all that is known of.
  } else {
    SPLINEMAP_RETURN_IF_ERROR(ReadDigest());
    const bool is_whole = is_digest && last->revision == digest_revision_ && !is_to_list_ &&
                          digest_hash_ != 0 && digest_hash_ == HashOf(DigestOf(layer));
    if (is_whole) {
      in_store_.clear();
      layer.tiles.ForEach([&](TileKey key, const TileTree::Entry&) {
        const BlockKey block = BlockKey::Of(key);
        if (!in_store_.contains(block))
          in_store_[block] = HashOf(BlockOf(layer.tiles, block), block);
      });
    } else {
      SPLINEMAP_RETURN_IF_ERROR(List());
    }
  }
  connections_ = connections;
  is_compared_ = true;
  is_to_list_ = false;
  return absl::OkStatus();
}

absl::Status LayerUpload::ReadDigest() {
  digest_revision_ = 0;
  digest_hash_ = 0;
  session_in_store_.reset();
  const absl::StatusOr<FleetEntry> entry = store_.Get(DigestKey(id_));
  if (absl::IsOutOfRange(entry.status())) return absl::OkStatus();
  if (!entry.ok()) return entry.status();
  digest_revision_ = entry->revision;
  // One that is damaged is written anew.
  const absl::StatusOr<LayerDigest> digest = DecodeDigest(entry->value, id_);
  if (!digest.ok()) return absl::OkStatus();
  session_in_store_ = digest->session;
  digest_hash_ = HashOf(*digest);
  return absl::OkStatus();
}

absl::Status LayerUpload::List() {
  std::map<BlockKey, uint64_t> blocks;
  SPLINEMAP_RETURN_IF_ERROR(
      store_.List(TilesFilter(id_), /*with_values=*/false, [&](const FleetEntry& entry) {
        const FleetKey key = ParseFleetKey(entry.key);
        if (key.kind == FleetKey::Kind::kBlock && entry.hash != 0) blocks[key.block] = entry.hash;
      }));
  in_store_ = std::move(blocks);
  ++counts_.listed;
  return absl::OkStatus();
}

void LayerUpload::SumDirtyBlocks() {
  for (const BlockKey& key : dirty_) {
    const LayerBlock block = BlockOf(tiles_, key);
    if (block.IsEmpty()) {
      sums_.erase(key);
    } else {
      sums_[key] = block.SumOf(key);
    }
  }
}

absl::Status LayerUpload::WriteBlocks(const LayerSnapshot& layer, Pace pace) {
  // What changed first goes first.
  struct Due {
    uint64_t revision;
    BlockKey key;
    auto operator<=>(const Due&) const = default;
  };
  std::vector<Due> due;
  for (auto key = dirty_.begin(); key != dirty_.end();) {
    const LayerBlock block = BlockOf(layer.tiles, *key);
    const auto stored = in_store_.find(*key);
    const uint64_t hash = HashOf(block, *key);
    if (hash == (stored == in_store_.end() ? 0 : stored->second)) {
      key = dirty_.erase(key);
      continue;
    }
    uint64_t newest = 0;
    for (const LayerBlock::Entry& entry : block.tiles) newest = std::max(newest, entry.revision);
    due.push_back({newest, *key});
    ++key;
  }
  std::sort(due.begin(), due.end());
  for (size_t k = 0; k < due.size();) {
    std::vector<FleetEntry> batch;
    int64_t bytes = 0;
    size_t end = k;
    for (; end < due.size() && bytes < kBatchBytes; ++end) {
      const BlockKey key = due[end].key;
      const LayerBlock block = BlockOf(layer.tiles, key);
      SPLINEMAP_ASSIGN_OR_RETURN(std::string value, EncodeBlock(block, key, &id_));
      bytes += static_cast<int64_t>(value.size()) + kOverheadBytes;
      batch.push_back({BlockKeyOf(id_, key), std::move(value), HashOf(block, key)});
    }
    if (!pace(bytes)) return absl::CancelledError("the upload was ended");
    SPLINEMAP_RETURN_IF_ERROR(CheckConnection());
    if (absl::Status status = store_.Put(batch); !status.ok()) {
      is_compared_ = false;
      return status;
    }
    for (size_t written = k; written < end; ++written) {
      const BlockKey key = due[written].key;
      if (batch[written - k].value.empty()) {
        in_store_.erase(key);
      } else {
        in_store_[key] = batch[written - k].hash;
      }
      dirty_.erase(key);
      ++counts_.blocks;
      counts_.bytes += static_cast<int64_t>(batch[written - k].value.size());
    }
    k = end;
  }
  return absl::OkStatus();
}

LayerDigest LayerUpload::DigestOf(const LayerSnapshot& layer) const {
  LayerDigest digest{id_, layer.session, layer.revision, 0, 0, 0, options_, {}, false};
  for (const auto& [key, sum] : sums_) {
    digest.tiles += sum.tiles;
    digest.hash += sum.hash;
    digest.box.Add(key.Tile(0));
    digest.box.Add(key.Tile(15));
  }
  return digest;
}

absl::Status LayerUpload::WriteDigest(LayerDigest digest) {
  const uint64_t hash = HashOf(digest);
  if (hash == digest_hash_) return absl::OkStatus();
  SPLINEMAP_RETURN_IF_ERROR(CheckConnection());
  digest.utime = HostUtime();
  const FleetEntry entry{DigestKey(id_), EncodeDigest(digest), hash};
  const absl::StatusOr<uint64_t> revision = store_.PutIf(entry, digest_revision_);
  if (!revision.ok()) {
    is_compared_ = false;  // somebody wrote it, the engine forgot it, or nobody knows
    return absl::IsAborted(revision.status())
               ? Unavailable("the fleet's copy of {} was changed beside; it is compared again",
                             id_.name)
               : revision.status();
  }
  digest_revision_ = *revision;
  digest_hash_ = hash;
  session_in_store_ = digest.session;
  SPLINEMAP_RETURN_IF_ERROR(CheckConnection());
  ++counts_.digests;
  counts_.bytes += static_cast<int64_t>(entry.value.size());
  return absl::OkStatus();
}

absl::Status LayerUpload::Look() {
  if (!is_compared_) return absl::OkStatus();
  const absl::StatusOr<FleetEntry> last = store_.Get(LayerFilter(id_));
  if (!last.ok() && !absl::IsOutOfRange(last.status())) return last.status();
  const uint64_t revision = last.ok() ? last->revision : 0;
  if (revision != digest_revision_ && dirty_.empty()) is_compared_ = false;
  return absl::OkStatus();
}

}  // namespace splinemap
