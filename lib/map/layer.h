#pragma once

#include <compare>
#include <cstdint>
#include <string>

#include "lib/map/tile.h"
#include "lib/map/tile_tree.h"

namespace splinemap {

// What a layer is called for ever: the name of its robot and 64 random bits kept in the map file.
struct LayerId {
  std::string name;
  uint64_t origin = 0;
  auto operator<=>(const LayerId&) const = default;
};

// One life of a layer's owner. A greater epoch replaces the layer as a whole.
struct LayerEpoch {
  // The greatest that may be said; no honest owner gets there.
  static constexpr uint64_t kMaxIncarnation = uint64_t{1} << 61;

  uint64_t incarnation = 0;  // counts starts
  uint64_t nonce = 0;        // random per start, tells two owners of one incarnation apart
  auto operator<=>(const LayerEpoch&) const = default;
};

// The greatest number of a commit that may be said; no honest owner gets there.
inline constexpr uint64_t kMaxRevision = uint64_t{1} << 61;

// A layer that does not change any more. Thread-safe.
struct LayerSnapshot {
  LayerId id;
  LayerEpoch epoch;
  uint64_t revision = 0;  // commits so far
  TileTree tiles;
};

// What one source has measured, in its own frame. Thread-compatible.
class Layer {
 public:
  Layer(LayerId id, LayerEpoch epoch) : id_(std::move(id)), epoch_(epoch) {}
  // Goes on where `base` ended, in a new epoch.
  Layer(const LayerSnapshot& base, LayerEpoch epoch)
      : id_(base.id), epoch_(epoch), revision_(base.revision), tiles_(base.tiles) {}

  const LayerId& id() const { return id_; }
  const LayerEpoch& epoch() const { return epoch_; }
  uint64_t revision() const { return revision_; }
  const TileTree& tiles() const { return tiles_.tree(); }

  // Goes on as another life, or as another layer, with the same tiles.
  void BeginLife(LayerId id, LayerEpoch epoch) {
    id_ = std::move(id);
    epoch_ = epoch;
  }

  // Goes on as another life without tiles.
  void BeginEmptyLife(LayerEpoch epoch) {
    BeginLife(id_, epoch);
    BeginCommit();
    tiles_ = TileTreeEditor();
  }

  // Begins the next commit; edits belong to it until the next call. Snapshots are taken between
  // commits only, so none holds half of one.
  void BeginCommit() { ++revision_; }
  // Requires a commit. The reference is valid until the next call.
  Tile& EditTile(TileKey key) { return tiles_.Edit(key, revision_); }

  // Restores what a file or another owner's update says, unless the layer has that revision of the
  // tile or a newer one; the layer's revision grows with it. Requires IsInRange(key).
  void RestoreTile(TileKey key, std::shared_ptr<const Tile> tile, uint64_t revision);
  void RestoreRevision(uint64_t revision);

  LayerSnapshot Snapshot() { return {id_, epoch_, revision_, tiles_.Freeze()}; }

 private:
  LayerId id_;
  LayerEpoch epoch_;
  uint64_t revision_ = 0;
  TileTreeEditor tiles_;
};

}  // namespace splinemap
