#pragma once

// Bodies of key_tree.h. Include it in the one source file that instantiates a tree.

#include <algorithm>
#include <array>
#include <atomic>
#include <bitset>
#include <optional>

#include "splinemap/key_tree.h"

namespace splinemap {
namespace key_tree {

inline constexpr int kMaxHeight = 9;

// 4 in every octal digit: added to a coordinate it turns balanced digits into plain ones, so that
// small keys of either sign share a small root.
inline constexpr uint32_t kBias = 4 * ((uint32_t{1} << (3 * kMaxHeight)) - 1) / 7;
static_assert(kBias == 0444444444);
static_assert((kMaxKnotIndex >> 5) < (uint32_t{1} << (3 * kMaxHeight)) - kBias);

inline uint32_t Biased(int32_t coordinate) { return static_cast<uint32_t>(coordinate) + kBias; }
inline int32_t Unbiased(uint32_t biased) { return static_cast<int32_t>(biased - kBias); }

inline int ChildIndex(uint32_t x, uint32_t y, int level) {
  return static_cast<int>((((y >> (3 * level)) & 7) << 3) | ((x >> (3 * level)) & 7));
}

inline int ChildInLeaf(TileKey key) { return ChildIndex(Biased(key.tx), Biased(key.ty), 0); }

inline constexpr int kCentreChild = (4 << 3) | 4;

// Versions are unique in the process, so no editor takes another's nodes for its own, and they
// grow, so a node knows from its own version when something below it changed last.
inline uint64_t NextVersion() {
  static std::atomic<uint64_t> version{0};
  return ++version;
}

}  // namespace key_tree

template <typename Value>
struct KeyTree<Value>::Node {
  uint64_t version = 0;  // of the last change in it or below
};

template <typename Value>
struct KeyTree<Value>::Inner : Node {
  std::array<std::shared_ptr<Node>, 64> children;
};

// By child.
template <typename Value>
struct KeyTree<Value>::Leaf : Node {
  std::array<Slot, 64> slots;
  std::array<uint64_t, 64> versions{};  // of the last change
  std::bitset<64> is_shared;            // with others than trees, who must not see edits
};

template <typename Value>
bool KeyTree<Value>::Covers(TileKey key) const {
  const int shift = 3 * height_;
  return (key_tree::Biased(key.tx) >> shift) == (key_tree::kBias >> shift) &&
         (key_tree::Biased(key.ty) >> shift) == (key_tree::kBias >> shift);
}

template <typename Value>
const typename KeyTree<Value>::Leaf* KeyTree<Value>::FindLeaf(TileKey key) const {
  if (!root_ || !Covers(key)) return nullptr;
  const uint32_t x = key_tree::Biased(key.tx);
  const uint32_t y = key_tree::Biased(key.ty);
  const Node* node = root_.get();
  for (int level = height_ - 1; level > 0 && node != nullptr; --level) {
    node = static_cast<const Inner*>(node)->children[key_tree::ChildIndex(x, y, level)].get();
  }
  return static_cast<const Leaf*>(node);
}

template <typename Value>
const typename KeyTree<Value>::Slot& KeyTree<Value>::AbsentSlot() {
  static const Slot absent;
  return absent;
}

template <typename Value>
const typename KeyTree<Value>::Slot& KeyTree<Value>::FindSlot(TileKey key) const {
  const Leaf* leaf = FindLeaf(key);
  return leaf == nullptr ? AbsentSlot() : leaf->slots[key_tree::ChildInLeaf(key)];
}

template <typename Value>
const Value* KeyTree<Value>::Find(TileKey key) const {
  return FindSlot(key).value.get();
}

template <typename Value>
void KeyTree<Value>::FindSlots(absl::Span<const TileKey> keys,
                               absl::Span<const Slot*> slots) const {
  for (size_t n = 0; n < keys.size(); ++n) {
    slots[n] = &FindSlot(keys[n]);
    __builtin_prefetch(slots[n]);
  }
}

template <typename Value>
std::shared_ptr<const Value> KeyTree<Value>::Share(TileKey key) const {
  return FindSlot(key).value;
}

template <typename Value>
uint64_t KeyTree<Value>::RevisionOf(TileKey key) const {
  return FindSlot(key).revision;
}

// Leaf by leaf.
template <typename Value>
void KeyTree<Value>::ForEachIn(TileKey first, TileKey last, Visitor visit) const {
  const auto last_in_leaf = [](int32_t from, int32_t last_of_all) {
    return std::min(last_of_all, key_tree::Unbiased(key_tree::Biased(from) | 7));
  };
  for (int32_t ty = first.ty; ty <= last.ty;) {
    const int32_t last_ty = last_in_leaf(ty, last.ty);
    for (int32_t tx = first.tx; tx <= last.tx;) {
      const int32_t last_tx = last_in_leaf(tx, last.tx);
      if (const Leaf* leaf = FindLeaf({tx, ty})) {
        for (TileKey key{tx, ty}; key.ty <= last_ty; ++key.ty) {
          for (key.tx = tx; key.tx <= last_tx; ++key.tx) {
            const Slot& slot = leaf->slots[key_tree::ChildInLeaf(key)];
            if (slot.value) visit(key, {slot.value, slot.revision});
          }
        }
      }
      tx = last_tx + 1;
    }
    ty = last_ty + 1;
  }
}

template <typename Value>
void KeyTree<Value>::ForEachChanged(uint64_t since, Visitor visit) const {
  if (!root_) return;
  const int shift = 3 * height_;
  const uint32_t corner = (key_tree::kBias >> shift) << shift;
  Visit(*root_, height_ - 1, corner, corner, since, visit);
}

template <typename Value>
void KeyTree<Value>::Visit(const Node& node, int level, uint32_t x, uint32_t y, uint64_t since,
                           Visitor visit) {
  if (node.version <= since) return;
  for (uint32_t child = 0; child < 64; ++child) {
    const uint32_t child_x = x | ((child & 7) << (3 * level));
    const uint32_t child_y = y | ((child >> 3) << (3 * level));
    if (level > 0) {
      const auto& next = static_cast<const Inner&>(node).children[child];
      if (next) Visit(*next, level - 1, child_x, child_y, since, visit);
    } else {
      const Leaf& leaf = static_cast<const Leaf&>(node);
      const Slot& slot = leaf.slots[child];
      if (slot.value && leaf.versions[child] > since) {
        visit({key_tree::Unbiased(child_x), key_tree::Unbiased(child_y)},
              {slot.value, slot.revision});
      }
    }
  }
}

// What of a tree lies in a square of some level: a node, or, above its root, all of it.
template <typename Value>
struct KeyTree<Value>::Part {
  const Node* node;
  int height;  // of the tree

  // Requires a level above 0.
  Part Child(uint32_t child, int level) const {
    if (node == nullptr) return *this;
    if (level >= height) return {child == key_tree::kCentreChild ? node : nullptr, height};
    return {static_cast<const Inner*>(node)->children[child].get(), height};
  }
};

template <typename Value>
void KeyTree<Value>::ForEachDifference(const KeyTree& before, const KeyTree& after,
                                       DifferenceVisitor visit) {
  const int height = std::max(before.height_, after.height_);
  if (height == 0) return;
  const int shift = 3 * height;
  const uint32_t corner = (key_tree::kBias >> shift) << shift;
  VisitDifferences(Part{before.root_.get(), before.height_}, Part{after.root_.get(), after.height_},
                   height - 1, corner, corner, visit);
}

template <typename Value>
void KeyTree<Value>::VisitDifferences(const Part& before, const Part& after, int level, uint32_t x,
                                      uint32_t y, DifferenceVisitor visit) {
  const bool are_equal_kind = (level < before.height) == (level < after.height);
  if (before.node == after.node && (are_equal_kind || before.node == nullptr)) return;
  if (level == 0) {
    return VisitDifferences(static_cast<const Leaf*>(before.node),
                            static_cast<const Leaf*>(after.node), x, y, visit);
  }
  for (uint32_t child = 0; child < 64; ++child) {
    VisitDifferences(before.Child(child, level), after.Child(child, level), level - 1,
                     x | ((child & 7) << (3 * level)), y | ((child >> 3) << (3 * level)), visit);
  }
}

template <typename Value>
void KeyTree<Value>::VisitDifferences(const Leaf* before, const Leaf* after, uint32_t x, uint32_t y,
                                      DifferenceVisitor visit) {
  for (uint32_t child = 0; child < 64; ++child) {
    const bool was = before != nullptr && before->slots[child].value != nullptr;
    const bool is = after != nullptr && after->slots[child].value != nullptr;
    if (!was && !is) continue;
    if (was && is && before->slots[child].value == after->slots[child].value &&
        before->slots[child].revision == after->slots[child].revision) {
      continue;
    }
    const auto entry = [child](const Leaf& leaf) {
      return Entry{leaf.slots[child].value, leaf.slots[child].revision};
    };
    std::optional<Entry> entry_before;
    std::optional<Entry> entry_after;
    if (was) entry_before.emplace(entry(*before));
    if (is) entry_after.emplace(entry(*after));
    visit({key_tree::Unbiased(x | (child & 7)), key_tree::Unbiased(y | (child >> 3))},
          was ? &*entry_before : nullptr, is ? &*entry_after : nullptr);
  }
}

template <typename Value>
KeyTreeEditor<Value>::KeyTreeEditor(Tree base) : tree_(std::move(base)) {
  tree_.version_ = key_tree::NextVersion();
  tree_.lineage_ = tree_.version_;
}

template <typename Value>
template <typename NodeType>
NodeType& KeyTreeEditor<Value>::Own(std::shared_ptr<typename Tree::Node>& node) {
  if (!node) {
    node = std::make_shared<NodeType>();
  } else if (node->version != tree_.version_) {
    node = std::make_shared<NodeType>(static_cast<const NodeType&>(*node));
  }
  node->version = tree_.version_;
  return static_cast<NodeType&>(*node);
}

template <typename Value>
typename KeyTree<Value>::Leaf& KeyTreeEditor<Value>::OwnLeaf(TileKey key) {
  while (tree_.height_ == 0 || !tree_.Covers(key)) {
    std::shared_ptr<typename Tree::Node> below = std::move(tree_.root_);
    tree_.root_ = nullptr;
    if (below)
      Own<typename Tree::Inner>(tree_.root_).children[key_tree::kCentreChild] = std::move(below);
    ++tree_.height_;
  }
  const uint32_t x = key_tree::Biased(key.tx);
  const uint32_t y = key_tree::Biased(key.ty);
  std::shared_ptr<typename Tree::Node>* node = &tree_.root_;
  for (int level = tree_.height_ - 1; level > 0; --level) {
    auto& inner = Own<typename Tree::Inner>(*node);
    node = &inner.children[key_tree::ChildIndex(x, y, level)];
  }
  return Own<typename Tree::Leaf>(*node);
}

template <typename Value>
Value& KeyTreeEditor<Value>::Edit(TileKey key, uint64_t revision) {
  auto& leaf = OwnLeaf(key);
  const int child = key_tree::ChildInLeaf(key);
  auto& slot = leaf.slots[child];
  if (!slot.value) {
    slot.value = std::make_shared<Value>();
    ++tree_.size_;
  } else if (leaf.is_shared[child] || leaf.versions[child] != tree_.version_) {
    slot.value = std::make_shared<Value>(*slot.value);
  }
  slot.hint.Clear();
  slot.revision = revision;
  leaf.versions[child] = tree_.version_;
  leaf.is_shared[child] = false;
  // Made here as a non-const Value, and no frozen tree has it yet.
  return const_cast<Value&>(*slot.value);
}

template <typename Value>
void KeyTreeEditor<Value>::Put(TileKey key, std::shared_ptr<const Value> tile, uint64_t revision) {
  auto& leaf = OwnLeaf(key);
  const int child = key_tree::ChildInLeaf(key);
  auto& slot = leaf.slots[child];
  if (!slot.value) ++tree_.size_;
  slot.value = std::move(tile);
  slot.hint.Clear();
  slot.revision = revision;
  leaf.versions[child] = tree_.version_;
  leaf.is_shared[child] = true;
}

template <typename Value>
KeyTree<Value> KeyTreeEditor<Value>::Freeze() {
  Tree frozen = tree_;
  tree_.version_ = key_tree::NextVersion();
  return frozen;
}

}  // namespace splinemap
