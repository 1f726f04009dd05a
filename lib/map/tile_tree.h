#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <memory>

#include "absl/functional/function_ref.h"
#include "absl/types/span.h"
#include "lib/map/tile.h"

namespace splinemap {

// An immutable map from TileKey to tile and revision. Copying is O(1) and shares everything;
// thread-safe. A TileTreeEditor makes new trees that share with old ones what did not change.
//
// Inside: a radix tree of 8 x 8 children per node over the digits of the key in balanced base 8
// (digits -4 .. 3), whose root covers just the keys in use. Every node knows when something below
// it changed last, so that visiting what changed costs what changed.
class TileTree {
 public:
  struct Entry {
    const std::shared_ptr<const Tile>& tile;
    uint64_t revision;  // of the owner's commit that last changed the tile
  };
  using Visitor = absl::FunctionRef<void(TileKey, const Entry&)>;

  // Null where the tile is absent. Valid as long as this tree.
  const Tile* Find(TileKey key) const;
  // The same for many keys, faster where the tree is larger than the caches. Requires as many tiles
  // as keys.
  void FindMany(absl::Span<const TileKey> keys, absl::Span<const Tile*> tiles) const;
  // The same, for those who keep it longer.
  std::shared_ptr<const Tile> Share(TileKey key) const;
  // 0 where the tile is absent.
  uint64_t RevisionOf(TileKey key) const;

  // Visits each tile once; the order depends on the keys alone.
  void ForEach(Visitor visit) const { ForEachChanged(0, visit); }
  // As above, for the tiles that were written after an older tree of the same line of edits was
  // frozen, whose epoch() is `since`.
  void ForEachChanged(uint64_t since, Visitor visit) const;

  // Counts freezes in this process: later trees have greater epochs.
  uint64_t epoch() const { return epoch_; }

  size_t size() const { return size_; }

 private:
  friend class TileTreeEditor;
  struct Node;
  struct Inner;
  struct Leaf;

  bool Covers(TileKey key) const;
  const Leaf* FindLeaf(TileKey key) const;
  static void Visit(const Node& node, int level, uint32_t x, uint32_t y, uint64_t since,
                    Visitor visit);

  std::shared_ptr<Node> root_;
  int height_ = 0;  // levels of nodes; the root covers 8^height tiles each way
  size_t size_ = 0;
  uint64_t epoch_ = 0;
};

// Changes a tree; keys have to be IsInRange(). Writes in place what no frozen tree shares and
// copies the rest, so an edit after a Freeze() costs one path of nodes and one tile.
// Thread-compatible.
class TileTreeEditor {
 public:
  // Begins with an empty tree, or with `base`, which stays as it is.
  explicit TileTreeEditor(TileTree base = {});
  TileTreeEditor(TileTreeEditor&&) = default;
  TileTreeEditor& operator=(TileTreeEditor&&) = default;

  // The present state; changes with the next edit.
  const TileTree& tree() const { return tree_; }

  // The tile to be written now, all zeros where it was absent, stamped with `revision`. The
  // reference is valid until the next call.
  Tile& Edit(TileKey key, uint64_t revision);

  // Replaces or adds a tile that others may share.
  void Put(TileKey key, std::shared_ptr<const Tile> tile, uint64_t revision);

  // The present state as an immutable tree.
  TileTree Freeze();

 private:
  TileTree::Leaf& OwnLeaf(TileKey key);
  template <typename NodeType>
  NodeType& Own(std::shared_ptr<TileTree::Node>& node);

  TileTree tree_;  // nodes and tiles of its epoch are shared with no frozen tree
};

}  // namespace splinemap
