#include "lib/mapping/scan_scratch.h"

#include <algorithm>

namespace splinemap {
namespace {

// To the nearest unit of a control point, halves to even: no bias, however many scans add up.
int32_t Round(int32_t sum) {
  constexpr int32_t kHalf = 1 << (ScanScratch::kFractionBits - 1);
  const int32_t odd = (sum >> ScanScratch::kFractionBits) & 1;
  return (sum + kHalf - 1 + odd) >> ScanScratch::kFractionBits;
}

bool AnyRoundsToNonzero(const std::array<int32_t, Tile::kSize>& sums) {
  return std::any_of(sums.begin(), sums.end(), [](int32_t sum) { return Round(sum) != 0; });
}

}  // namespace

std::array<int32_t, Tile::kSize>& ScanScratch::SumsOf(TileKey key) {
  if (!index_.empty() && key == last_key_) return tiles_[last_].sums;
  const auto [place, is_new] = index_.try_emplace(key, index_.size());
  last_key_ = key;
  last_ = place->second;
  if (is_new) {
    if (last_ == tiles_.size()) tiles_.emplace_back();
    tiles_[last_].key = key;
    tiles_[last_].sums.fill(0);
  }
  return tiles_[last_].sums;
}

void ScanScratch::CommitTo(Layer& layer, ControlLimits limits, ControlLimits scan_limits) {
  layer.BeginCommit();
  for (size_t n = 0; n < index_.size(); ++n) {
    const Sums& scan = tiles_[n];
    if (!AnyRoundsToNonzero(scan.sums)) continue;
    Tile& tile = layer.EditTile(scan.key);
    for (int k = 0; k < Tile::kSize; ++k) {
      const int32_t sum = Round(scan.sums[k]);
      if (sum == 0) continue;
      const int32_t change = std::clamp<int32_t>(sum, scan_limits.min, scan_limits.max);
      tile.control_points[k] = ClampTouched(tile.control_points[k] + change, limits);
    }
  }
  index_.clear();
}

}  // namespace splinemap
