#include "lib/mapping/scan_scratch.h"

#include <cstddef>
#include <cstring>

namespace splinemap {
namespace {

constexpr size_t kBytesOfSums = Tile::kSide * SumBlock::kStride * sizeof(int32_t);

const BeamMemory* MemoryOf(absl::Span<const PlacedBeam> beams) {
  static_assert(sizeof(PlacedBeam) == sizeof(BeamMemory));
  static_assert(offsetof(PlacedBeam, direction_world) == offsetof(BeamMemory, direction_world));
  static_assert(offsetof(PlacedBeam, range_m) == offsetof(BeamMemory, range_m));
  return reinterpret_cast<const BeamMemory*>(beams.data());
}

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

// Those of a tile that was touched, or null.
int32_t* FindSums(SumPlane& plane, int32_t tx, int32_t ty) {
  SumBlock* block = plane.Find(tx, ty >> 2);
  return block == nullptr || (block->touched >> (ty & 3) & 1) == 0 ? nullptr
                                                                   : SumsOf(*block, ty & 3);
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
  if (steep_lines_.size() <= beams.size()) {
    steep_lines_.resize(beams.size() + 1);
    shallow_lines_.resize(beams.size() + 1);
  }
  const LineCounts counts = kernel_.set_lines(MemoryOf(beams), beams.size(), model,
                                              steep_lines_.data(), shallow_lines_.data());
  kernel_.add_lines(steep_lines_.data(), counts.steep, upright_);
  kernel_.add_lines(shallow_lines_.data(), counts.shallow, transposed_);
}

void ScanScratch::AddFaceLines(absl::Span<const PlacedBeam> beams, absl::Span<const Face> faces,
                               const FreeLineModel& model) {
  if (steep_faces_.size() <= beams.size()) {
    steep_lines_.resize(beams.size() + 1);
    shallow_lines_.resize(beams.size() + 1);
    steep_faces_.resize(beams.size() + 1);
    shallow_faces_.resize(beams.size() + 1);
  }
  const ScanKernel::FaceLineCounts counts = kernel_.set_face_lines(
      MemoryOf(beams), faces.data(), beams.size(), model, steep_lines_.data(),
      shallow_lines_.data(), steep_faces_.data(), shallow_faces_.data());
  kernel_.add_lines(steep_lines_.data(), counts.free.steep, upright_);
  kernel_.add_lines(shallow_lines_.data(), counts.free.shallow, transposed_);
  kernel_.add_faces(steep_faces_.data(), counts.face.steep, upright_, occupied_upright_);
  kernel_.add_faces(shallow_faces_.data(), counts.face.shallow, transposed_, occupied_transposed_);
  has_distances_ = true;
}

void ScanScratch::CommitTo(Layer& layer, ControlLimits limits, ControlLimits scan_limits) {
  Collect(upright_, transposed_);
  layer.BeginCommit();
  if (has_distances_) {
    CommitDistances(layer, limits);
  } else {
    CommitSums(layer, limits, scan_limits);
  }
  upright_.Clear();
  has_distances_ = false;
}

void ScanScratch::CommitSums(Layer& layer, ControlLimits limits, ControlLimits scan_limits) {
  ForEachTouched(upright_, [&](int32_t tx, int32_t ty, int32_t* sums) {
    if (kernel_.has_change(sums)) {
      kernel_.commit(sums, limits, scan_limits, layer.EditTile({tx, ty}).control_points.data());
    } else {
      std::memset(sums, 0, kBytesOfSums);
    }
  });
}

void ScanScratch::CommitDistances(Layer& layer, ControlLimits limits) {
  static const Tile kUntouched;
  Tile result;
  Collect(occupied_upright_, occupied_transposed_);
  ForEachTouched(upright_, [&](int32_t tx, int32_t ty, int32_t* weights) {
    const Tile* tile = layer.tiles().Find({tx, ty});
    if (kernel_.commit_distances(weights, FindSums(occupied_upright_, tx, ty), limits,
                                 (tile == nullptr ? kUntouched : *tile).control_points.data(),
                                 result.control_points.data())) {
      layer.EditTile({tx, ty}) = result;
    }
  });
  occupied_upright_.Clear();
}

void ScanScratch::Collect(SumPlane& upright, SumPlane& transposed) const {
  MoveAprons(transposed);
  ForEachTouched(transposed, [&](int32_t tx, int32_t ty, int32_t* sums) {
    kernel_.move_transposed(sums, Touch(upright, ty, tx));
  });
  transposed.Clear();
  MoveAprons(upright);
}

void ScanScratch::MoveAprons(SumPlane& plane) const {
  ForEachTouched(plane, [&](int32_t tx, int32_t ty, int32_t* sums) {
    if (kernel_.has_apron(sums)) kernel_.move_apron(sums, Touch(plane, tx + 1, ty));
  });
}

}  // namespace splinemap
