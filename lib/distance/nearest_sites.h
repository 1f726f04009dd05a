#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "absl/types/span.h"
#include "lib/distance/distance_kernel.h"

namespace splinemap {

// Of each vertex of a block, x runs fastest.
using BlockOffsets = std::array<SiteOffset, VertexBlock::kSize>;

class SomeSites {
 public:
  // Keeps those that may be nearer, or as near, to a vertex of the box than another site is. All
  // from the corner of the same tile, and none more than 16,200 from one of the box, each way.
  // Valid until the next call.
  absl::Span<const Site> NotHidden(absl::Span<const Site> sites, const VertexBox& box,
                                   const Site& other);

 private:
  std::vector<Site> kept_;
};

// The nearest sites of the vertices of a block, of those within reach. Of sites that are equally
// near that of the least y, of these that of the least x: in whatever order they are added.
class NearestSites {
 public:
  enum class Of { kAllVertices, kLostOnes };  // others keep what they have

  // Of the first row there are 8 offsets, of each other 32 after the one before.
  NearestSites(Of vertices, const SiteOffset* offsets, int32_t reach_squared);

  // Block and sites from the corner of the same tile, no coordinate more than 20,000 away. Whether
  // a vertex takes one of them.
  bool Add(absl::Span<const Site> sites, const VertexBlock& block);

  // Whether a vertex has one of the sites: it loses that.
  bool TakeAway(absl::Span<const Site> sites, const VertexBlock& block);

  // Those that had lost what they had when they were read, a bit for each.
  uint64_t LostOnes() const { return nearest_.lost; }

  // How far a site may be, squared, that a vertex takes.
  int32_t LongestSquared() const;

  // Of one of them; kNone where it has none, kLost where that was taken away.
  SiteOffset OffsetOf(int vertex) const;
  BlockOffsets Offsets() const;

 private:
  NearestOfBlock nearest_;
};

}  // namespace splinemap
