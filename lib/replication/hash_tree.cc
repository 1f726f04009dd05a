#include "lib/replication/hash_tree.h"

namespace splinemap {
namespace {

bool IsRoot(const NodeKey& node) {
  return node.x >= -1 && node.x <= 0 && node.y >= -1 && node.y <= 0;
}

}  // namespace

void HashTree::Set(TileKey key, uint64_t checksum) {
  NodeKey node{0, key.tx, key.ty};
  const auto [tile, is_new] = hashes_.try_emplace(node, 0);
  num_tiles_ += is_new ? 1 : 0;
  const uint64_t change = checksum - tile->second;
  tile->second = checksum;
  hash_ += change;
  while (node.level < kMaxLevel) {
    node = node.Parent();
    hashes_[node] += change;
    if (node.level >= root_level_ && !IsRoot(node)) root_level_ = node.level + 1;
  }
}

uint64_t HashTree::HashOf(const NodeKey& node) const {
  const auto found = hashes_.find(node);
  return found == hashes_.end() ? 0 : found->second;
}

std::vector<HashTree::Child> HashTree::ChildrenOf(const NodeKey& node) const {
  std::vector<Child> children;
  for (int k = 0; k < 64; ++k) {
    const auto found = hashes_.find(node.Child(k));
    if (found != hashes_.end()) children.push_back({k, found->second});
  }
  return children;
}

}  // namespace splinemap
