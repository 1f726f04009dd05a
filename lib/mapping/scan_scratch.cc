#include "lib/mapping/scan_scratch.h"

#include <cstring>

namespace splinemap {

void ScanScratch::CommitTo(Layer& layer, ControlLimits limits, ControlLimits scan_limits) {
  MoveAprons(transposed_);
  MoveTransposedToUpright();
  MoveAprons(upright_);
  layer.BeginCommit();
  for (size_t n = 0; n < upright_.size(); ++n) {
    SumBlock& block = upright_.block(n);
    if (kernel_.has_change(block)) {
      Tile& tile = layer.EditTile(block.key);
      kernel_.commit(block, limits, scan_limits, tile.control_points.data());
    } else {
      std::memset(block.sums, 0, sizeof block.sums);
    }
  }
  upright_.Clear();
}

void ScanScratch::MoveAprons(SumPlane& plane) const {
  const size_t count = plane.size();  // those that are added on the way have none
  for (size_t n = 0; n < count; ++n) {
    SumBlock& block = plane.block(n);
    if (!kernel_.has_apron(block)) continue;
    kernel_.move_apron(block, *plane.At(block.key.tx + 1, block.key.ty));
  }
}

void ScanScratch::MoveTransposedToUpright() {
  for (size_t n = 0; n < transposed_.size(); ++n) {
    SumBlock& block = transposed_.block(n);
    kernel_.move_transposed(block, *upright_.At(block.key.ty, block.key.tx));
  }
  transposed_.Clear();
}

}  // namespace splinemap
