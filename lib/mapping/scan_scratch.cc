#include "lib/mapping/scan_scratch.h"

#include <cstring>

#include "lib/mapping/beam_memory.h"

namespace splinemap {
namespace {

// Of the groups of a block's rows, those of a tile.
uint32_t GroupsOf(uint32_t groups, int up) {
  return groups >> (up * RowGroups::kPerTile) & RowGroups::kWholeTile;
}

// A tile of sums, and the groups of its rows that there may be some in.
template <typename Sum>
struct TouchedTile {
  int32_t tx;
  int32_t ty;
  Sum* sums;
  uint32_t groups;
};

// Null and no groups where there is none.
template <typename Sum>
TouchedTile<Sum> Find(SumPlane<Sum>& plane, int32_t tx, int32_t ty) {
  using Block = SumBlock<Sum>;
  Block* block = plane.Find(tx >> Block::kAcrossBits, ty >> Block::kUpBits);
  if (block == nullptr) return {tx, ty, nullptr, 0};
  const int across = tx & (Block::kAcross - 1);
  const int up = ty & (Block::kUp - 1);
  return {tx, ty, block->TileAt(across, up), GroupsOf(block->touched[across], up)};
}

// Finds or makes the sums of a tile, and marks groups of its rows as touched.
template <typename Sum>
Sum* Touch(SumPlane<Sum>& plane, int32_t tx, int32_t ty, uint32_t groups = RowGroups::kWholeTile) {
  using Block = SumBlock<Sum>;
  Block& block = *plane.At(tx >> Block::kAcrossBits, ty >> Block::kUpBits);
  const int across = tx & (Block::kAcross - 1);
  const int up = ty & (Block::kUp - 1);
  block.touched[across] |= groups << (up * RowGroups::kPerTile);
  return block.TileAt(across, up);
}

// Visits the tiles that were touched, in the columns [begin, end) of the tiles of each block.
// Blocks that the visitor adds are left out.
template <typename Sum, typename Visitor>
void ForEachTouched(SumPlane<Sum>& plane, int begin, int end, Visitor visit) {
  using Block = SumBlock<Sum>;
  const size_t count = plane.size();
  for (size_t n = 0; n < count; ++n) {
    Block& block = plane.block(n);
    for (int across = begin; across < end; ++across) {
      for (int up = 0; up < Block::kUp; ++up) {
        const uint32_t groups = GroupsOf(block.touched[across], up);
        if (groups == 0) continue;
        visit(TouchedTile<Sum>{block.column * Block::kAcross + across, block.row * Block::kUp + up,
                               block.TileAt(across, up), groups});
      }
    }
  }
}

template <typename Sum, typename Visitor>
void ForEachTouched(SumPlane<Sum>& plane, Visitor visit) {
  ForEachTouched(plane, 0, SumBlock<Sum>::kAcross, visit);
}

// What cannot be read, which its source tells, stays as it is: no scan writes over it.
bool IsReadable(const TileTreeEditor& tiles, TileKey key) {
  const StoredTile* tile = tiles.tree().Find(key);
  return tile == nullptr || tile->TryGet() != nullptr;
}

template <typename Sum, typename Visitor>
void ForEachTouchedApron(SumPlane<Sum>& plane, Visitor visit) {
  ForEachTouched(plane, SumBlock<Sum>::kAcross, SumBlock<Sum>::kAcross + 1, visit);
}

}  // namespace

int32_t& ScanScratch::At(int32_t i, int32_t j) {
  return Touch(log_odds_.upright, i >> 5, j >> 5)[(j & 31) * SumBlock<int32_t>::kStride + (i & 31)];
}

void ScanScratch::AddFreeLines(absl::Span<const PlacedBeam> beams, const FreeLineModel& model,
                               const FreeLineTable<int32_t>& table) {
  if (steep_lines_.size() <= beams.size()) {
    steep_lines_.resize(beams.size() + 1);
    shallow_lines_.resize(beams.size() + 1);
  }
  const LineCounts counts = kernel_.set_lines(MemoryOf(beams), beams.size(), model,
                                              steep_lines_.data(), shallow_lines_.data());
  kernel_.add_lines(steep_lines_.data(), counts.steep, table.data(), log_odds_.upright);
  kernel_.add_lines(shallow_lines_.data(), counts.shallow, table.data(), log_odds_.transposed);
}

void ScanScratch::AddFaceLines(absl::Span<const PlacedBeam> beams, absl::Span<const Face> faces,
                               double knots_per_m, const FreeLineTable<uint16_t>& free_table,
                               const FaceLineTable& face_table) {
  if (steep_faces_.size() <= beams.size()) {
    steep_lines_.resize(beams.size() + 1);
    shallow_lines_.resize(beams.size() + 1);
    steep_faces_.resize(beams.size() + 1);
    shallow_faces_.resize(beams.size() + 1);
  }
  const ScanKernel::FaceLineCounts counts = kernel_.set_face_lines(
      MemoryOf(beams), faces.data(), beams.size(), knots_per_m, steep_lines_.data(),
      shallow_lines_.data(), steep_faces_.data(), shallow_faces_.data());
  kernel_.add_free_lines(steep_lines_.data(), counts.free.steep, free_table.data(), free_.upright);
  kernel_.add_free_lines(shallow_lines_.data(), counts.free.shallow, free_table.data(),
                         free_.transposed);
  kernel_.add_faces(steep_faces_.data(), counts.face.steep, face_table.data(), faces_.upright);
  kernel_.add_faces(shallow_faces_.data(), counts.face.shallow, face_table.data(),
                    faces_.transposed);
}

void ScanScratch::CommitTo(Layer& layer, ControlLimits limits, ControlLimits scan_limits) {
  layer.Commit([&](TileTreeEditor& tiles, uint64_t revision) {
    CommitTo(tiles, revision, limits, scan_limits, [](TileKey) { return true; });
  });
}

void ScanScratch::CommitTo(TileTreeEditor& tiles, uint64_t revision, ControlLimits limits,
                           ControlLimits scan_limits, absl::FunctionRef<bool(TileKey)> is_taken) {
  const Commit commit{tiles, revision, limits, is_taken};
  CommitSums(commit, scan_limits);
  CommitDistances(commit);
}

void ScanScratch::CommitSums(const Commit& commit, ControlLimits scan_limits) {
  Collect(kernel_.log_odds, log_odds_);
  ForEachTouched(log_odds_.upright, [&](TouchedTile<int32_t> tile) {
    const TileKey key{tile.tx, tile.ty};
    if (kernel_.has_change(tile.sums) && commit.is_taken(key) && IsReadable(commit.tiles, key)) {
      kernel_.commit(tile.sums, commit.limits, scan_limits,
                     commit.tiles.Edit(key, commit.revision).Edit().control_points.data());
    } else {
      std::memset(tile.sums, 0, Tile::kSide * SumBlock<int32_t>::kStride * sizeof(*tile.sums));
    }
  });
  log_odds_.upright.Clear();
}

void ScanScratch::CommitDistances(const Commit& commit) {
  static const Tile kUntouched;
  Tile result;
  Collect(kernel_.free, free_);
  Collect(kernel_.faces, faces_);
  ForEachTouched(faces_.upright, [&](TouchedTile<FaceSum> tile) {
    Touch(free_.upright, tile.tx, tile.ty, tile.groups);
  });
  ForEachTouched(free_.upright, [&](TouchedTile<uint16_t> tile) {
    const TileKey key{tile.tx, tile.ty};
    const TouchedTile<FaceSum> faces = Find(faces_.upright, tile.tx, tile.ty);
    const std::shared_ptr<const Tile> from = FindTile(commit.tiles.tree(), key);
    // Also where the tile is not taken: it clears the sums.
    const bool is_changed = kernel_.commit_distances(
        tile.sums, tile.groups, faces.sums, faces.groups, commit.limits,
        (from == nullptr ? kUntouched : *from).control_points.data(), result.control_points.data());
    if (is_changed && commit.is_taken(key) && IsReadable(commit.tiles, key)) {
      commit.tiles.Put(key, std::make_shared<const StoredTile>(result), commit.revision);
    }
  });
  free_.upright.Clear();
  faces_.upright.Clear();
}

template <typename Sum>
void ScanScratch::Collect(const TileKernel<Sum>& kernel, Planes<Sum>& planes) {
  MoveAprons(kernel, planes.transposed);
  ForEachTouched(planes.transposed, [&](TouchedTile<Sum> tile) {
    kernel.move_transposed(tile.sums, tile.groups, Touch(planes.upright, tile.ty, tile.tx));
  });
  planes.transposed.Clear();
  MoveAprons(kernel, planes.upright);
}

template <typename Sum>
void ScanScratch::MoveAprons(const TileKernel<Sum>& kernel, SumPlane<Sum>& plane) {
  ForEachTouchedApron(plane, [&](TouchedTile<Sum> tile) {
    kernel.move_apron(tile.sums, tile.groups, Touch(plane, tile.tx, tile.ty, tile.groups));
  });
}

}  // namespace splinemap
