#pragma once

#include <cstdint>
#include <vector>

#include "absl/container/flat_hash_map.h"
#include "splinemap/tile.h"

namespace splinemap {

// A square of 8^level x 8^level tiles: (0, tx, ty) is a tile.
struct NodeKey {
  int32_t level = 0;
  int32_t x = 0;
  int32_t y = 0;

  auto operator<=>(const NodeKey&) const = default;
  template <typename H>
  friend H AbslHashValue(H h, const NodeKey& key) {
    return H::combine(std::move(h), key.level, key.x, key.y);
  }

  // Whether there can be such a node; those above tiles up to HashTree::kMaxLevel, 8.
  bool IsValid() const {
    if (level < 0 || level > 8) return false;
    const int32_t limit = int32_t{1} << (24 - 3 * level);
    return x >= -limit && x < limit && y >= -limit && y < limit;
  }

  NodeKey Parent() const { return {level + 1, x >> 3, y >> 3}; }
  // Requires level > 0 and 0 <= k < 64.
  NodeKey Child(int k) const { return {level - 1, 8 * x + (k & 7), 8 * y + (k >> 3)}; }
};

// Checksums of the tiles of a layer and their sums over squares of them, so that two copies of a
// layer find where they differ by comparing a few numbers. Thread-compatible.
class HashTree {
 public:
  static constexpr int kMaxLevel = 8;  // from there on nodes have x, y in {-1, 0}

  // Of one tile; replaces what was there.
  void Set(TileKey key, uint64_t checksum);

  // The sum of the checksums below, modulo 2^64; 0 where there is none.
  uint64_t HashOf(const NodeKey& node) const;
  // Of all tiles.
  uint64_t hash() const { return hash_; }
  size_t num_tiles() const { return num_tiles_; }

  struct Child {
    int k = 0;
    uint64_t hash = 0;
  };
  // Those that have tiles. Requires node.level > 0.
  std::vector<Child> ChildrenOf(const NodeKey& node) const;

  // Least level > 0 at which the nodes with x, y in {-1, 0} cover all tiles.
  int root_level() const { return root_level_; }

 private:
  absl::flat_hash_map<NodeKey, uint64_t> hashes_;
  uint64_t hash_ = 0;
  size_t num_tiles_ = 0;
  int root_level_ = 1;
};

}  // namespace splinemap
