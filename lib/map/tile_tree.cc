#include "lib/map/tile_tree.h"

#include <atomic>

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

struct TileTree::OwnedEntry : Entry {
  uint64_t epoch = 0;      // of the last change
  bool is_shared = false;  // with others than trees, who must not see edits
};

struct TileTree::Inner : Node {
  std::array<std::shared_ptr<Node>, 64> children;
};

struct TileTree::Leaf : Node {
  std::array<OwnedEntry, 64> entries;
};

bool TileTree::Covers(TileKey key) const {
  const int shift = 3 * height_;
  return (Biased(key.tx) >> shift) == (kBias >> shift) &&
         (Biased(key.ty) >> shift) == (kBias >> shift);
}

const TileTree::Entry* TileTree::Find(TileKey key) const {
  if (!root_ || !Covers(key)) return nullptr;
  const uint32_t x = Biased(key.tx);
  const uint32_t y = Biased(key.ty);
  const Node* node = root_.get();
  for (int level = height_ - 1; level > 0; --level) {
    node = static_cast<const Inner*>(node)->children[ChildIndex(x, y, level)].get();
    if (node == nullptr) return nullptr;
  }
  const Entry& entry = static_cast<const Leaf*>(node)->entries[ChildIndex(x, y, 0)];
  return entry.tile ? &entry : nullptr;
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
      const OwnedEntry& entry = static_cast<const Leaf&>(node).entries[child];
      if (entry.tile && entry.epoch > since) {
        visit({Unbiased(child_x), Unbiased(child_y)}, entry);
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

TileTree::OwnedEntry& TileTreeEditor::Slot(TileKey key) {
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
  auto& leaf = Own<TileTree::Leaf>(*node);
  TileTree::OwnedEntry& entry = leaf.entries[ChildIndex(x, y, 0)];
  if (!entry.tile) ++tree_.size_;
  return entry;
}

Tile& TileTreeEditor::Edit(TileKey key, uint64_t revision) {
  TileTree::OwnedEntry& entry = Slot(key);
  if (!entry.tile) {
    entry.tile = std::make_shared<Tile>();
  } else if (entry.is_shared || entry.epoch != tree_.epoch_) {
    entry.tile = std::make_shared<Tile>(*entry.tile);
  }
  entry.revision = revision;
  entry.epoch = tree_.epoch_;
  entry.is_shared = false;
  // Made here as a non-const Tile, and no frozen tree has it yet.
  return const_cast<Tile&>(*entry.tile);
}

void TileTreeEditor::Put(TileKey key, std::shared_ptr<const Tile> tile, uint64_t revision) {
  TileTree::OwnedEntry& entry = Slot(key);
  entry.tile = std::move(tile);
  entry.revision = revision;
  entry.epoch = tree_.epoch_;
  entry.is_shared = true;
}

TileTree TileTreeEditor::Freeze() {
  TileTree frozen = tree_;
  tree_.epoch_ = NextEpoch();
  return frozen;
}

}  // namespace splinemap
