#include "lib/fleet/sum_upload.h"

#include <chrono>
#include <utility>
#include <vector>

#include "lib/base/status.h"
#include "lib/fleet/sum_block.h"

namespace splinemap {
namespace {

// The engine may forget without a word, and another worker write what is older.
constexpr std::chrono::seconds kSumCompareInterval(60);
// Written before what was written is acknowledged.
constexpr size_t kSumBatch = 32;

bool HasPart(const PartSet& parts, BlockKey block) {
  return parts[static_cast<size_t>(PartOf(block))];
}

}  // namespace

absl::Status SumUpload::Bring(const MapView& map, const PartSet& parts) {
  if (store_.connections() != connections_ || Clock::now() - compared_at_ > kSumCompareInterval) {
    connections_ = store_.connections();
    compared_at_ = Clock::now();
    compared_.reset();
  }
  // What others write meanwhile is not known.
  compared_ &= parts;
  std::erase_if(in_store_, [&](const auto& entry) { return !HasPart(compared_, entry.first); });
  std::erase_if(dirty_, [&](BlockKey block) { return !HasPart(compared_, block); });
  TileTree::ForEachDifference(tiles_, map.tiles,
                              [&](TileKey key, const TileTree::Entry*, const TileTree::Entry*) {
                                const BlockKey block = BlockKey::Of(key);
                                if (HasPart(compared_, block)) dirty_.insert(block);
                              });
  tiles_ = map.tiles;
  absl::Status status = Compare(parts & ~compared_);
  if (status.ok()) status = WriteBlocks();
  if (!status.ok()) compared_.reset();  // nobody knows what was written
  return status;
}

absl::Status SumUpload::Compare(const PartSet& parts) {
  if (parts.none()) return absl::OkStatus();
  for (int part = 0; part < kParts; ++part) {
    if (!parts[static_cast<size_t>(part)]) continue;
    SPLINEMAP_RETURN_IF_ERROR(
        store_.List(SumFilter(part), /*with_values=*/false, [&](const FleetEntry& entry) {
          const std::optional<BlockKey> block = ParseSumKey(entry.key);
          if (!block || entry.hash == 0) return;
          in_store_[*block] = entry.hash;
          dirty_.insert(*block);
        }));
  }
  tiles_.ForEach([&](TileKey key, const TileTree::Entry&) {
    const BlockKey block = BlockKey::Of(key);
    if (HasPart(parts, block)) dirty_.insert(block);
  });
  compared_ |= parts;
  return absl::OkStatus();
}

absl::Status SumUpload::WriteBlocks() {
  while (!dirty_.empty()) {
    std::vector<FleetEntry> batch;
    std::vector<BlockKey> written;
    while (!dirty_.empty() && batch.size() < kSumBatch) {
      const BlockKey key = *dirty_.begin();
      const LayerBlock block = SumBlockOf(tiles_, key);
      const uint64_t hash = HashOf(block, key);
      const auto stored = in_store_.find(key);
      if (hash != (stored == in_store_.end() ? 0 : stored->second)) {
        SPLINEMAP_ASSIGN_OR_RETURN(std::string value, EncodeBlock(block, key, nullptr));
        batch.push_back({SumKey(key), std::move(value), hash});
        written.push_back(key);
      }
      dirty_.erase(dirty_.begin());
    }
    SPLINEMAP_RETURN_IF_ERROR(store_.Put(batch));
    for (size_t k = 0; k < batch.size(); ++k) {
      if (batch[k].value.empty()) {
        in_store_.erase(written[k]);
      } else {
        in_store_[written[k]] = batch[k].hash;
      }
    }
    blocks_ += static_cast<int64_t>(batch.size());
  }
  return absl::OkStatus();
}

}  // namespace splinemap
