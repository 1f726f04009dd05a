#pragma once

#include <array>
#include <cstdint>

#include "absl/types/span.h"
#include "lib/distance/distance_kernel.h"

namespace splinemap {

// Of each vertex of a block, x runs fastest.
using BlockOffsets = std::array<SiteOffset, VertexBlock::kSize>;

// Whether one of the sites is what a vertex of the block has at its offset; then also the offsets,
// kLost where that is so. Of the first row there are 8 offsets, of each other 32 after the one
// before.
bool TakeAway(absl::Span<const Site> sites, const VertexBlock& block, const SiteOffset* offsets,
              BlockOffsets& without);

// Some of few enough sites: those of the squares of a block.
class SomeSites {
 public:
  // Keeps those that may be nearer, or as near, to a vertex of the box than another site is. All
  // from the corner of the same tile, and none more than 16,200 from one of the box, each way.
  // Valid until the next call.
  absl::Span<const Site> NotHidden(absl::Span<const Site> sites, const VertexBox& box,
                                   const Site& other);

 private:
  std::array<Site, 1024> kept_;
};

// The nearest sites of the vertices of a block, of those within reach. Of sites that are equally
// near that of the least y, of these that of the least x: in whatever order they are added.
class NearestSites {
 public:
  enum class Of { kAllVertices, kLostOnes };  // others keep what they have

  // Offsets as above.
  NearestSites(Of vertices, const SiteOffset* offsets, int32_t reach_squared);

  // Block and sites from the corner of the same tile, no coordinate more than 20,000 away. Whether
  // a vertex takes one of them.
  bool Add(absl::Span<const Site> sites, const VertexBlock& block);

  // How far a site may be, squared, that a vertex takes.
  int32_t LongestSquared() const;

  // Of one of them; kNone where it has none.
  SiteOffset OffsetOf(int vertex) const;
  BlockOffsets Offsets() const;

 private:
  NearestOfBlock nearest_;
};

}  // namespace splinemap
