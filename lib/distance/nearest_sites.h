#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "absl/types/span.h"

namespace splinemap {

// In eighths of a knot interval, from the corner of a tile.
struct Site {
  static constexpr int kUnits = 8;

  int32_t x;
  int32_t y;
  bool operator==(const Site&) const = default;
};

// From a vertex to a site.
struct SiteOffset {
  static constexpr int16_t kNone = INT16_MIN;  // nothing is near

  int16_t x = kNone;
  int16_t y = kNone;
  bool operator==(const SiteOffset&) const = default;
};

// Many of them, by coordinate: the first `size` of what is there.
struct Sites {
  size_t size = 0;
  std::vector<int32_t> x;
  std::vector<int32_t> y;

  // Room for so many more, which are to be written; larger vectors serve again.
  void Add(size_t count) {
    size += count;
    if (x.size() >= size) return;
    x.resize(2 * size);
    y.resize(2 * size);
  }
  void Add(const Site& site) {
    Add(1);
    x[size - 1] = site.x;
    y[size - 1] = site.y;
  }
};

// 8 x 8 vertices of the knot grid, (x0, y0) the first of them, counted from the corner of a tile.
struct VertexBlock {
  static constexpr int kSide = 8;
  static constexpr int kSize = kSide * kSide;

  int x0;
  int y0;
};

// Adds [begin, end) of the others, moved by `shift`. The least squared distance from `centre`.
int32_t AddSites(const Sites& others, size_t begin, size_t end, const Site& shift,
                 const Site& centre, Sites& sites);

// Whether one of the sites is what a vertex of the block has at its offset. Of the first row there
// are 8 offsets, of each other 32 after the one before.
bool HasAny(absl::Span<const Site> sites, const VertexBlock& block, const SiteOffset* offsets);

// What the vertices of a block have when sites came.
struct WithSites {
  bool is_any_as_near = false;  // as what a vertex had, or as another of the sites
  bool is_any_nearer = false;   // than what a vertex had
  // Where one is nearer and none as near; as the length, squared, of none counts the reach.
  std::array<SiteOffset, VertexBlock::kSize> offsets;
  int32_t longest_squared = 0;
};
// Offsets as above; where there is none, sites within `reach` are nearer.
WithSites AddToBlock(absl::Span<const Site> sites, const VertexBlock& block,
                     const SiteOffset* offsets, int32_t reach_squared);

// Finds the nearest of some sites. Thread-compatible.
class NearestSites {
 public:
  // Of each vertex of the block, x runs fastest, the nearest site; of those that are equally near
  // the first. Requires a site, and of all sites coordinates that are odd, as those of centres of
  // squares are, and up to 20,000 in amount. Leaves out sites that are nearest to no vertex.
  using Nearest = std::array<Site, VertexBlock::kSize>;
  Nearest Find(Sites& sites, const VertexBlock& block);

  // By instructions that every processor has.
  Nearest FindPlainly(Sites& sites, const VertexBlock& block);

 private:
  std::vector<int32_t> squared_;
  std::vector<uint8_t> is_kept_;
};

}  // namespace splinemap
