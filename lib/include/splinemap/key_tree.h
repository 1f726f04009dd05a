#pragma once

#include <array>
#include <atomic>
#include <cstddef>
#include <cstdint>
#include <memory>

#include "absl/functional/function_ref.h"
#include "absl/types/span.h"
#include "splinemap/tile.h"

namespace splinemap {

template <typename Value>
class KeyTreeEditor;

// An immutable map from TileKey to value and revision. Copying is O(1) and shares everything;
// thread-safe. A KeyTreeEditor makes new trees that share with old ones what did not change.
// key_tree_impl.h has the bodies; see tile_tree.cc for how a type of value gets them.
//
// Inside: a radix tree of 8 x 8 children per node over the digits of the key in balanced base 8
// (digits -4 .. 3), whose root covers just the keys in use. Every node knows when something below
// it changed last, so that visiting what changed costs what changed.
template <typename Value>
class KeyTree {
 public:
  struct Entry {
    const std::shared_ptr<const Value>& tile;
    uint64_t revision;  // of the owner's commit that last changed it
  };
  using Visitor = absl::FunctionRef<void(TileKey, const Entry&)>;

  // Null where it is absent. Valid as long as this tree.
  const Value* Find(TileKey key) const;
  // What readers leave beside a value for the next of them: where its content is. Of a copy: empty.
  class Hint {
   public:
    Hint() = default;
    Hint(const Hint& /*other*/) {}
    Hint& operator=(const Hint& /*other*/) = delete;

    // What was set last, where that had this stamp; else null.
    const void* Get(uint64_t stamp) const {
      const uint64_t word = word_.load(std::memory_order_acquire);
      if ((word & (kMaxStamps - 1)) != stamp) return nullptr;
      return reinterpret_cast<const void*>(static_cast<uintptr_t>(word / kMaxStamps * kAlignment));
    }
    // Requires an address that 64 divides. Leaves it where there is no room for such an address or
    // stamp: after four million of them, readers look themselves again.
    void Set(const void* content, uint64_t stamp) const {
      const uint64_t address = reinterpret_cast<uintptr_t>(content);
      if (address >> 48 != 0 || stamp >= kMaxStamps) return;
      word_.store(address / kAlignment * kMaxStamps + stamp, std::memory_order_release);
    }
    void Clear() { word_.store(0, std::memory_order_relaxed); }

   private:
    static constexpr uint64_t kAlignment = 64;
    static constexpr uint64_t kMaxStamps = uint64_t{1} << 22;
    mutable std::atomic<uint64_t> word_{0};  // both, so that no reader sees one without the other
  };
  // What a query needs of a value stands close together.
  struct alignas(32) Slot {
    std::shared_ptr<const Value> value;  // null where it is absent
    Hint hint;
    uint64_t revision = 0;
  };
  const Slot& FindSlot(TileKey key) const;
  // The same for many keys, faster where the tree is larger than the caches. Requires room for as
  // many slots as keys.
  void FindSlots(absl::Span<const TileKey> keys, absl::Span<const Slot*> slots) const;
  // The value, for those who keep it longer.
  std::shared_ptr<const Value> Share(TileKey key) const;
  // 0 where it is absent.
  uint64_t RevisionOf(TileKey key) const;

  // Visits each value once; the order depends on the keys alone.
  void ForEach(Visitor visit) const { ForEachChanged(0, visit); }
  // As above, for the keys from `first` to `last`, both included, in x and y. Costs little where
  // they are close together.
  void ForEachIn(TileKey first, TileKey last, Visitor visit) const;
  // For those that were written after an older tree of the same lineage() was frozen,
  // whose version() is `since`.
  void ForEachChanged(uint64_t since, Visitor visit) const;

  // Visits the keys at which frozen trees have other objects or revisions, with what each has, null
  // where that is nothing. Costs what differs, where one was made from the other.
  using DifferenceVisitor =
      absl::FunctionRef<void(TileKey, const Entry* before, const Entry* after)>;
  static void ForEachDifference(const KeyTree& before, const KeyTree& after,
                                DifferenceVisitor visit);

  // Counts freezes in this process: later trees have greater versions.
  uint64_t version() const { return version_; }
  // All trees that one editor has frozen have one line, and no others.
  uint64_t lineage() const { return lineage_; }

  size_t size() const { return size_; }

 private:
  friend class KeyTreeEditor<Value>;
  struct Node;
  struct Inner;
  struct Leaf;

  bool Covers(TileKey key) const;
  const Leaf* FindLeaf(TileKey key) const;
  static const Slot& AbsentSlot();
  static void Visit(const Node& node, int level, uint32_t x, uint32_t y, uint64_t since,
                    Visitor visit);
  struct Part;
  static void VisitDifferences(const Part& before, const Part& after, int level, uint32_t x,
                               uint32_t y, DifferenceVisitor visit);
  static void VisitDifferences(const Leaf* before, const Leaf* after, uint32_t x, uint32_t y,
                               DifferenceVisitor visit);

  std::shared_ptr<Node> root_;
  int height_ = 0;  // levels of nodes; the root covers 8^height tiles each way
  size_t size_ = 0;
  uint64_t version_ = 0;
  uint64_t lineage_ = 0;
};

// Changes a tree; keys have to be IsInRange(). Writes in place what no frozen tree shares and
// copies the rest, so an edit after a Freeze() costs one path of nodes and one value.
// Thread-compatible.
template <typename Value>
class KeyTreeEditor {
  using Tree = KeyTree<Value>;

 public:
  // Begins with an empty tree, or with `base`, which stays as it is.
  explicit KeyTreeEditor(Tree base = {});
  KeyTreeEditor(KeyTreeEditor&&) = default;
  KeyTreeEditor& operator=(KeyTreeEditor&&) = default;

  // The present state; changes with the next edit.
  const Tree& tree() const { return tree_; }

  // The value to be written now, Value() where it was absent, stamped with `revision`. The
  // reference is valid until the next call. Nobody queries tree() before the value is written.
  Value& Edit(TileKey key, uint64_t revision);

  // Replaces or adds a value that others may share.
  void Put(TileKey key, std::shared_ptr<const Value> value, uint64_t revision);

  // The present state as an immutable tree.
  Tree Freeze();

 private:
  typename Tree::Leaf& OwnLeaf(TileKey key);
  template <typename NodeType>
  NodeType& Own(std::shared_ptr<typename Tree::Node>& node);

  Tree tree_;  // nodes and values of its version are shared with no frozen tree
};

}  // namespace splinemap
