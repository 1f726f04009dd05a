#include "lib/distance/nearest_sites.h"

namespace splinemap {

absl::Span<const Site> SomeSites::NotHidden(absl::Span<const Site> sites, const VertexBox& box,
                                            const Site& other) {
  if (kept_.size() < sites.size() + DistanceKernel::kSpareSites) {
    kept_.resize(sites.size() + DistanceKernel::kSpareSites);
  }
  const int count = FastestDistanceKernel().keep_not_hidden(
      sites.data(), static_cast<int>(sites.size()), box, other, kept_.data());
  return {kept_.data(), static_cast<size_t>(count)};
}

NearestSites::NearestSites(Of vertices, const SiteOffset* offsets, int32_t reach_squared) {
  nearest_.reach_squared = reach_squared;
  FastestDistanceKernel().read(offsets, vertices == Of::kLostOnes, nearest_);
}

bool NearestSites::Add(absl::Span<const Site> sites, const VertexBlock& block) {
  return FastestDistanceKernel().add(sites.data(), static_cast<int>(sites.size()), block, nearest_);
}

bool NearestSites::TakeAway(absl::Span<const Site> sites, const VertexBlock& block) {
  return FastestDistanceKernel().take_away(sites.data(), static_cast<int>(sites.size()), block,
                                           nearest_);
}

int32_t NearestSites::LongestSquared() const {
  return FastestDistanceKernel().longest_squared(nearest_);
}

SiteOffset NearestSites::OffsetOf(int vertex) const {
  const int32_t both = nearest_.ways[vertex] ^ NearestOfBlock::kBias;
  return {static_cast<int16_t>(both & 0xFFFF), static_cast<int16_t>(both >> 16)};
}

BlockOffsets NearestSites::Offsets() const {
  BlockOffsets offsets;
  FastestDistanceKernel().write(nearest_, offsets.data());
  return offsets;
}

}  // namespace splinemap
