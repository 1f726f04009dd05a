#pragma once

#include <compare>
#include <cstdint>
#include <memory>
#include <string>

#include "splinemap/tile.h"
#include "splinemap/tile_tree.h"

namespace splinemap {

// What a layer is called for ever: the name of its robot and 64 random bits kept in the map file.
struct LayerId {
  std::string name;
  uint64_t origin = 0;
  auto operator<=>(const LayerId&) const = default;
};

// One session of a layer's owner. A greater session replaces the layer as a whole.
struct SessionId {
  // The greatest that may be said; no honest owner gets there.
  static constexpr uint64_t kMaxNumber = uint64_t{1} << 61;

  uint64_t number = 0;  // counts starts
  uint64_t nonce = 0;   // random per start, tells two owners of one number apart
  auto operator<=>(const SessionId&) const = default;
};

// The greatest number of a commit that may be said; no honest owner gets there.
inline constexpr uint64_t kMaxRevision = uint64_t{1} << 61;

class ScanArchive;

// A layer that does not change any more. Thread-safe.
struct LayerSnapshot {
  LayerId id;
  SessionId session;
  uint64_t revision = 0;  // commits so far
  TileTree tiles;
  // The scans that the tiles are made of, for their owner and in files; null where they are not
  // kept. Archives do not travel over LCM.
  std::shared_ptr<const ScanArchive> archive{};
};

// What one source has measured, in its own frame. Thread-compatible.
class Layer {
 public:
  Layer(LayerId id, SessionId session) : id_(std::move(id)), session_(session) {}
  // Goes on where `base` ended, in a new session.
  Layer(const LayerSnapshot& base, SessionId session)
      : id_(base.id), session_(session), revision_(base.revision), tiles_(base.tiles) {}

  const LayerId& id() const { return id_; }
  const SessionId& session() const { return session_; }
  uint64_t revision() const { return revision_; }
  const TileTree& tiles() const { return tiles_.tree(); }

  // Goes on as another session, or as another layer, with the same tiles.
  void StartSession(LayerId id, SessionId session) {
    id_ = std::move(id);
    session_ = session;
  }

  // Goes on as another session without tiles.
  void StartEmptySession(SessionId session) {
    StartSession(id_, session);
    BeginCommit();
    tiles_ = TileTreeEditor();
  }

  // Begins the next commit; edits belong to it until the next call. Snapshots are taken between
  // commits only, so none holds half of one.
  void BeginCommit() { ++revision_; }
  // Requires a commit. The reference is valid until the next call.
  Tile& EditTile(TileKey key) { return tiles_.Edit(key, revision_).Edit(); }
  // The next commit, made of the edits of `edit`, which stamps them with the revision that it gets.
  template <typename Edit>  // void(TileTreeEditor& tiles, uint64_t revision)
  void Commit(Edit edit) {
    BeginCommit();
    edit(tiles_, revision_);
  }

  // Restores what a file or another owner's update says, unless the layer has that revision of the
  // tile or a newer one; the layer's revision grows with it. Requires IsInRange(key).
  void RestoreTile(TileKey key, std::shared_ptr<const StoredTile> tile, uint64_t revision);
  void RestoreRevision(uint64_t revision);

  // Other tiles in place of those that are there, in another session: they are another fold.
  void ReplaceTiles(SessionId session, TileTree tiles) {
    StartSession(id_, session);
    BeginCommit();
    tiles_ = TileTreeEditor(std::move(tiles));
  }

  LayerSnapshot Snapshot() { return {id_, session_, revision_, tiles_.Freeze()}; }

 private:
  LayerId id_;
  SessionId session_;
  uint64_t revision_ = 0;
  TileTreeEditor tiles_;
};

}  // namespace splinemap
