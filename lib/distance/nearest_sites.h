#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "absl/types/span.h"
#include "lib/distance/vectors.h"

namespace splinemap {

// In eighths of a knot interval, from the corner of a tile.
struct Site {
  static constexpr int kUnits = 8;

  int16_t x;
  int16_t y;
  bool operator==(const Site&) const = default;
};

// From a vertex to a site.
struct SiteOffset {
  static constexpr int16_t kNone = INT16_MIN;  // nothing is near

  int16_t x = kNone;
  int16_t y = kNone;
  bool operator==(const SiteOffset&) const = default;
};

// To no site: the vertex had one that went, and what is nearest now is to be found.
inline constexpr SiteOffset kLost{0, 0};

// 8 x 8 vertices of the knot grid, (x0, y0) the first of them, counted from the corner of a tile.
struct VertexBlock {
  static constexpr int kSide = 8;
  static constexpr int kSize = kSide * kSide;

  int x0;
  int y0;
};

// Of each vertex of a block, x runs fastest.
using BlockOffsets = std::array<SiteOffset, VertexBlock::kSize>;

// Whether one of the sites is what a vertex of the block has at its offset; then also the offsets,
// kLost where that is so. Of the first row there are 8 offsets, of each other 32 after the one
// before.
bool TakeAway(absl::Span<const Site> sites, const VertexBlock& block, const SiteOffset* offsets,
              BlockOffsets& without);

// A box of vertices, in the units of sites.
struct VertexBox {
  Site low;
  Site high;
};

// Some of few enough sites: those of the squares of a block.
class SomeSites {
 public:
  // Keeps those that may be nearer, or as near, to a vertex of the box than another site is. All
  // from the corner of the same tile. Valid until the next call.
  absl::Span<const Site> NotHidden(absl::Span<const Site> sites, const VertexBox& box,
                                   const Site& other);

 private:
  friend struct NearestSitesKernel;
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

  // By instructions that every processor has.
  bool AddPlainly(absl::Span<const Site> sites, const VertexBlock& block);

  // How far a site may be, squared, that a vertex takes.
  int32_t LongestSquared() const;

  // Of one of them; kNone where it has none.
  SiteOffset OffsetOf(int vertex) const;
  BlockOffsets Offsets() const;

 private:
  using Rows = std::array<Integers8, VertexBlock::kSide>;
  friend struct NearestSitesKernel;

  int32_t reach_squared_;
  Rows ways_;  // offsets, as kBias says
  // Where nothing is near one more than the reach; negative where a vertex keeps what it has.
  Rows squared_;
};

}  // namespace splinemap
