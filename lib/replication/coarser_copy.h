#pragma once

#include <algorithm>
#include <cstdint>
#include <limits>
#include <optional>

#include "lib/layers/layer_pyramid.h"
#include "splinemap/layer.h"
#include "splinemap/region.h"

namespace splinemap {

// A coarser level of a layer that is followed as it was mapped, or of a part of it.
// Thread-compatible.
class CoarserCopy {
 public:
  // `box` is of the level; none: all tiles.
  CoarserCopy(LevelOfDetail level_of_detail, std::optional<TileBox> box)
      : level_of_detail_(level_of_detail), box_(box), pyramid_(level_of_detail.level) {}

  // The tiles of the layer that a part is made of.
  static TileBox FinerBox(const TileBox& box, int level) {
    // Each level reaches two control points further than the next.
    const int64_t margin = (1 << level) / (Tile::kSide / 2) + 1;
    const auto finer = [&](int64_t t, int64_t more) {
      constexpr int64_t kMost = 1 << 24;  // beyond all tiles
      return static_cast<int32_t>(std::clamp(t * (1 << level) + more, -kMost, kMost));
    };
    return {finer(box.tx0, -margin), finer(box.ty0, -margin), finer(box.tx1, margin),
            finer(box.ty1, margin)};
  }

  // Costs what changed since the last call.
  LayerSnapshot Update(const LayerSnapshot& layer) {
    if (lineage_ != layer.tiles.lineage() || session_ != layer.session) {
      lineage_ = layer.tiles.lineage();
      session_ = layer.session;
      pyramid_ = LayerPyramid(level_of_detail_.level);
      part_ = TileTreeEditor();
      up_to_ = 0;
    }
    pyramid_.Advance(layer, std::numeric_limits<size_t>::max());
    LayerSnapshot coarser = pyramid_.Layer(level_of_detail_);
    if (!box_) return coarser;
    coarser.tiles.ForEachChanged(up_to_, [&](TileKey key, const TileTree::Entry& entry) {
      if (box_->Contains(key)) part_.Put(key, entry.tile, entry.revision);
    });
    up_to_ = coarser.tiles.version();
    coarser.tiles = part_.Freeze();
    return coarser;
  }

 private:
  LevelOfDetail level_of_detail_;
  std::optional<TileBox> box_;
  LayerPyramid pyramid_;
  TileTreeEditor part_;
  uint64_t up_to_ = 0;
  uint64_t lineage_ = 0;
  SessionId session_;
};

}  // namespace splinemap
