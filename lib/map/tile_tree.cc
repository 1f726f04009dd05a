#include "lib/map/tile_tree.h"

#include <algorithm>
#include <array>
#include <atomic>
#include <bitset>

namespace splinemap {
namespace {

constexpr int kMaxHeight = 9;

// 4 in every octal digit: added to a coordinate it turns balanced digits into plain ones, so that
// small keys of either sign share a small root.
constexpr uint32_t kBias = 4 * ((uint32_t{1} << (3 * kMaxHeight)) - 1) / 7;
static_assert(kBias == 0444444444);
static_assert((kMaxKnotIndex >> 5) < (uint32_t{1} << (3 * kMaxHeight)) - kBias);

uint32_t Biased(int32_t coordinate) { return static_cast<uint32_t>(coordinate) + kBias; }
int32_t Unbiased(uint32_t biased) { return static_cast<int32_t>(biased - kBias); }

int ChildIndex(uint32_t x, uint32_t y, int level) {
  return static_cast<int>((((y >> (3 * level)) & 7) << 3) | ((x >> (3 * level)) & 7));
}

int ChildInLeaf(TileKey key) { return ChildIndex(Biased(key.tx), Biased(key.ty), 0); }

constexpr int kCentreChild = (4 << 3) | 4;

// Epochs are unique in the process, so no editor takes another's nodes for its own, and they grow,
// so a node knows from its own epoch when something below it changed last.
uint64_t NextEpoch() {
  static std::atomic<uint64_t> epoch{0};
  return ++epoch;
}

}  // namespace

struct TileTree::Node {
  uint64_t epoch = 0;  // of the last change in it or below
};

struct TileTree::Inner : Node {
  std::array<std::shared_ptr<Node>, 64> children;
};

// By child; what queries look at stands close together.
struct TileTree::Leaf : Node {
  std::array<std::shared_ptr<const Tile>, 64> tiles;
  std::array<uint64_t, 64> revisions{};
  std::array<uint64_t, 64> epochs{};  // of the last change
  std::bitset<64> is_shared;          // with others than trees, who must not see edits
};

bool TileTree::Covers(TileKey key) const {
  const int shift = 3 * height_;
  return (Biased(key.tx) >> shift) == (kBias >> shift) &&
         (Biased(key.ty) >> shift) == (kBias >> shift);
}

const TileTree::Leaf* TileTree::FindLeaf(TileKey key) const {
  if (!root_ || !Covers(key)) return nullptr;
  const uint32_t x = Biased(key.tx);
  const uint32_t y = Biased(key.ty);
  const Node* node = root_.get();
  for (int level = height_ - 1; level > 0 && node != nullptr; --level) {
    node = static_cast<const Inner*>(node)->children[ChildIndex(x, y, level)].get();
  }
  return static_cast<const Leaf*>(node);
}

const Tile* TileTree::Find(TileKey key) const {
  const Leaf* leaf = FindLeaf(key);
  return leaf == nullptr ? nullptr : leaf->tiles[ChildInLeaf(key)].get();
}

// The second loop is short, so that the processor waits for many leaves at once.
void TileTree::FindMany(absl::Span<const TileKey> keys, absl::Span<const Tile*> tiles) const {
  static const std::shared_ptr<const Tile> absent;
  constexpr size_t kBlock = 256;
  std::array<const std::shared_ptr<const Tile>*, kBlock> slots;
  for (size_t begin = 0; begin < keys.size(); begin += kBlock) {
    const size_t count = std::min(kBlock, keys.size() - begin);
    for (size_t n = 0; n < count; ++n) {
      const TileKey key = keys[begin + n];
      const Leaf* leaf = FindLeaf(key);
      slots[n] = leaf == nullptr ? &absent : &leaf->tiles[ChildInLeaf(key)];
    }
    for (size_t n = 0; n < count; ++n) tiles[begin + n] = slots[n]->get();
  }
}

std::shared_ptr<const Tile> TileTree::Share(TileKey key) const {
  const Leaf* leaf = FindLeaf(key);
  return leaf == nullptr ? nullptr : leaf->tiles[ChildInLeaf(key)];
}

uint64_t TileTree::RevisionOf(TileKey key) const {
  const Leaf* leaf = FindLeaf(key);
  return leaf == nullptr ? 0 : leaf->revisions[ChildInLeaf(key)];
}

void TileTree::ForEachChanged(uint64_t since, Visitor visit) const {
  if (!root_) return;
  const int shift = 3 * height_;
  const uint32_t corner = (kBias >> shift) << shift;
  Visit(*root_, height_ - 1, corner, corner, since, visit);
}

void TileTree::Visit(const Node& node, int level, uint32_t x, uint32_t y, uint64_t since,
                     Visitor visit) {
  if (node.epoch <= since) return;
  for (uint32_t child = 0; child < 64; ++child) {
    const uint32_t child_x = x | ((child & 7) << (3 * level));
    const uint32_t child_y = y | ((child >> 3) << (3 * level));
    if (level > 0) {
      const auto& next = static_cast<const Inner&>(node).children[child];
      if (next) Visit(*next, level - 1, child_x, child_y, since, visit);
    } else {
      const Leaf& leaf = static_cast<const Leaf&>(node);
      if (leaf.tiles[child] && leaf.epochs[child] > since) {
        visit({Unbiased(child_x), Unbiased(child_y)}, {leaf.tiles[child], leaf.revisions[child]});
      }
    }
  }
}

TileTreeEditor::TileTreeEditor(TileTree base) : tree_(std::move(base)) {
  tree_.epoch_ = NextEpoch();
}

template <typename NodeType>
NodeType& TileTreeEditor::Own(std::shared_ptr<TileTree::Node>& node) {
  if (!node) {
    node = std::make_shared<NodeType>();
  } else if (node->epoch != tree_.epoch_) {
    node = std::make_shared<NodeType>(static_cast<const NodeType&>(*node));
  }
  node->epoch = tree_.epoch_;
  return static_cast<NodeType&>(*node);
}

TileTree::Leaf& TileTreeEditor::OwnLeaf(TileKey key) {
  while (tree_.height_ == 0 || !tree_.Covers(key)) {
    std::shared_ptr<TileTree::Node> below = std::move(tree_.root_);
    tree_.root_ = nullptr;
    if (below) Own<TileTree::Inner>(tree_.root_).children[kCentreChild] = std::move(below);
    ++tree_.height_;
  }
  const uint32_t x = Biased(key.tx);
  const uint32_t y = Biased(key.ty);
  std::shared_ptr<TileTree::Node>* node = &tree_.root_;
  for (int level = tree_.height_ - 1; level > 0; --level) {
    auto& inner = Own<TileTree::Inner>(*node);
    node = &inner.children[ChildIndex(x, y, level)];
  }
  return Own<TileTree::Leaf>(*node);
}

Tile& TileTreeEditor::Edit(TileKey key, uint64_t revision) {
  TileTree::Leaf& leaf = OwnLeaf(key);
  const int child = ChildInLeaf(key);
  std::shared_ptr<const Tile>& tile = leaf.tiles[child];
  if (!tile) {
    tile = std::make_shared<Tile>();
    ++tree_.size_;
  } else if (leaf.is_shared[child] || leaf.epochs[child] != tree_.epoch_) {
    tile = std::make_shared<Tile>(*tile);
  }
  leaf.revisions[child] = revision;
  leaf.epochs[child] = tree_.epoch_;
  leaf.is_shared[child] = false;
  // Made here as a non-const Tile, and no frozen tree has it yet.
  return const_cast<Tile&>(*tile);
}

void TileTreeEditor::Put(TileKey key, std::shared_ptr<const Tile> tile, uint64_t revision) {
  TileTree::Leaf& leaf = OwnLeaf(key);
  const int child = ChildInLeaf(key);
  if (!leaf.tiles[child]) ++tree_.size_;
  leaf.tiles[child] = std::move(tile);
  leaf.revisions[child] = revision;
  leaf.epochs[child] = tree_.epoch_;
  leaf.is_shared[child] = true;
}

TileTree TileTreeEditor::Freeze() {
  TileTree frozen = tree_;
  tree_.epoch_ = NextEpoch();
  return frozen;
}

}  // namespace splinemap
