#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "splinemap/layer.h"
#include "splinemap/level_of_detail.h"
#include "splinemap/region.h"

namespace splinemap {

class KeyRing;  // splinemap/key_ring.h

// Which layers to follow, and what of them.
struct FollowOptions {
  std::string channel_prefix = "SPLINEMAP";
  // Null: nothing is signed, and whatever is on the bus is believed.
  std::shared_ptr<const KeyRing> keys;
  std::vector<std::string> names;  // of robots, or patterns with * ? [..]; empty: all
  std::optional<Region> region;    // in the map frame; none: all of the map
  // Coarser levels: smoothed values, or the least or greatest log-odds of the squares of 2^level x
  // 2^level control points, so that obstacles stay. The knot interval of the copy is 2^level times
  // the map's. Control point (i, j) stands for finer ones from (i, j) 2^level on. Layers that are
  // placed are resampled at the level; their least and greatest are those of all squares that one
  // of the map touches.
  LevelOfDetail level_of_detail;
  // Whether settings about layers are taken from the bus, and passed on. Else those that were
  // there at the beginning stay, and nobody on the bus can mute, place or remove a layer here.
  bool takes_settings = true;
  // Owners send scans, of which copies are made, and coarser levels of these. Whether tiles are
  // taken instead, and coarser levels as daemons make them: for who has little memory or a slow
  // processor, and needs little of a large map. While changes go on, tiles cost the bus many times
  // as much as scans.
  bool takes_tiles = false;
  // Of all layers together, 2 KiB each; what is beyond is left out, and layers are not in sync.
  size_t max_tiles = size_t{1} << 20;
};

// What became of the messages of a layer.
struct FollowCounts {
  int64_t folded = 0;       // scans
  int64_t applied = 0;      // tiles
  int64_t stale = 0;        // doubled, late, or of an older session
  int64_t unusable = 0;     // differences to what is not there, damaged ones, values that cannot be
  int64_t disowned = 0;     // tiles that its owner did not list, dropped or fetched anew
  int64_t foreign = 0;      // of another version of the protocol
  int64_t asked_tiles = 0;  // losses, and what a late joiner lacks
  int64_t asked_nodes = 0;
  int64_t asked_scans = 0;  // pulls of them
  int64_t misfolded = 0;    // copies made of scans that were not what a digest said
};

// A layer as a follower has it.
struct FollowedLayer {
  LayerId id;
  SessionId session;
  uint64_t revision = 0;  // of the digest with which it was in sync last
  size_t tiles = 0;
  uint64_t hash = 0;            // as in digests
  bool matches_digest = false;  // to what was published at the last digest
  bool caught_up = false;       // nothing of then is missing, and its owner or a proxy still speaks
  // Since the digest with which it was in sync last, and of what that left out; infinity where
  // there was none. What is shown is no older than that.
  double staleness_ms = 0;
  double heard_s_ago = -1;  // its owner; -1: not yet in this session
  bool owner_is_silent = false;
  FollowCounts counts;
};

}  // namespace splinemap
