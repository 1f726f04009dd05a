#include "lib/mapping/scan_scratch.h"

#include <cstddef>
#include <cstring>

namespace splinemap {
namespace {

// A tile's sums, kStride apart from row to row.
int32_t* SumsOf(SumBlock& block, int tile) {
  return block.sums + tile * Tile::kSide * SumBlock::kStride;
}

// Finds or makes the sums of a tile, and marks them as touched.
int32_t* Touch(SumPlane& plane, int32_t tx, int32_t ty) {
  SumBlock& block = *plane.At(tx, ty >> 2);
  static_assert(SumBlock::kTiles == 4);
  block.touched |= 1u << (ty & 3);
  return SumsOf(block, ty & 3);
}

// Visits (tx, ty, sums) of the tiles that were touched. Blocks that the visitor adds are left out.
template <typename Visitor>
void ForEachTouched(SumPlane& plane, Visitor visit) {
  const size_t count = plane.size();
  for (size_t n = 0; n < count; ++n) {
    SumBlock& block = plane.block(n);
    for (int tile = 0; tile < SumBlock::kTiles; ++tile) {
      if ((block.touched >> tile & 1) != 0) {
        visit(block.tx, block.row * SumBlock::kTiles + tile, SumsOf(block, tile));
      }
    }
  }
}

}  // namespace

int32_t& ScanScratch::At(int32_t i, int32_t j) {
  return Touch(upright_, i >> 5, j >> 5)[(j & 31) * SumBlock::kStride + (i & 31)];
}

void ScanScratch::AddFreeLines(absl::Span<const PlacedBeam> beams, const FreeLineModel& model) {
  static_assert(sizeof(PlacedBeam) == sizeof(BeamMemory));
  static_assert(offsetof(PlacedBeam, direction_world) == offsetof(BeamMemory, direction_world));
  static_assert(offsetof(PlacedBeam, range_m) == offsetof(BeamMemory, range_m));
  if (steep_lines_.size() <= beams.size()) {
    steep_lines_.resize(beams.size() + 1);
    shallow_lines_.resize(beams.size() + 1);
  }
  const FreeLineCounts counts =
      kernel_.set_lines(reinterpret_cast<const BeamMemory*>(beams.data()), beams.size(), model,
                        steep_lines_.data(), shallow_lines_.data());
  kernel_.add_lines(steep_lines_.data(), counts.steep, upright_);
  kernel_.add_lines(shallow_lines_.data(), counts.shallow, transposed_);
}

void ScanScratch::CommitTo(Layer& layer, ControlLimits limits, ControlLimits scan_limits) {
  MoveAprons(transposed_);
  MoveTransposedToUpright();
  MoveAprons(upright_);
  layer.BeginCommit();
  ForEachTouched(upright_, [&](int32_t tx, int32_t ty, int32_t* sums) {
    if (kernel_.has_change(sums)) {
      kernel_.commit(sums, limits, scan_limits, layer.EditTile({tx, ty}).control_points.data());
    } else {
      std::memset(sums, 0, Tile::kSide * SumBlock::kStride * sizeof *sums);
    }
  });
  upright_.Clear();
}

void ScanScratch::MoveAprons(SumPlane& plane) const {
  ForEachTouched(plane, [&](int32_t tx, int32_t ty, int32_t* sums) {
    if (kernel_.has_apron(sums)) kernel_.move_apron(sums, Touch(plane, tx + 1, ty));
  });
}

void ScanScratch::MoveTransposedToUpright() {
  ForEachTouched(transposed_, [&](int32_t tx, int32_t ty, int32_t* sums) {
    kernel_.move_transposed(sums, Touch(upright_, ty, tx));
  });
  transposed_.Clear();
}

}  // namespace splinemap
