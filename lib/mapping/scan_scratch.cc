#include "lib/mapping/scan_scratch.h"

#include <algorithm>
#include <cstring>
#include <utility>

#include "lib/base/read_section.h"
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

// Rows and columns of an 8 x 8 matrix of bits exchanged, by blocks of 1, 2 and 4.
TileCells Transposed(TileCells cells) {
  const auto exchange = [&](int way, TileCells upper_right) {
    const TileCells different = (cells ^ cells >> way) & upper_right;
    cells ^= different ^ different << way;
  };
  exchange(7, 0x00aa00aa00aa00aa);
  exchange(14, 0x0000cccc0000cccc);
  exchange(28, 0x00000000f0f0f0f0);
  return cells;
}

// The cells of a tile of a block that there are faces in, and those of its apron.
std::pair<TileCells, TileCells> FaceCellsOf(const SumBlock<FaceSum>& block, int up) {
  std::pair<TileCells, TileCells> cells;
  uint64_t any[2];
  std::memcpy(any, &block.marks.of_row[8 * up], sizeof(any));
  if ((any[0] | any[1]) == 0) return cells;
  for (int k = 0; k < 8; ++k) {
    const TileCells row = block.marks.of_row[8 * up + k];
    cells.first |= (row & 255) << (8 * k);
    cells.second |= (row >> 8) << (8 * k);
  }
  return cells;
}

// Sets the cells of tiles that there are faces in, in the upright plane.
void CollectFaceCells(const SumPlane<FaceSum>& transposed, SumPlane<FaceSum>& upright) {
  using Block = SumBlock<FaceSum>;
  const auto add = [&](int32_t tx, int32_t ty, TileCells cells) {
    if (cells == 0) return;
    upright.At(tx, ty >> Block::kUpBits)->marks.of_tile[ty & (Block::kUp - 1)] |= cells;
  };
  for (size_t n = 0; n < transposed.size(); ++n) {
    const Block& block = transposed.block(n);
    for (int up = 0; up < Block::kUp; ++up) {
      const auto [cells, of_apron] = FaceCellsOf(block, up);
      const int32_t tx = block.row * Block::kUp + up;
      add(tx, block.column, Transposed(cells));
      add(tx, block.column + 1, Transposed(of_apron));
    }
  }
  const size_t count = upright.size();
  for (size_t n = 0; n < count; ++n) {
    Block& block = upright.block(n);
    for (int up = 0; up < Block::kUp; ++up) {
      const auto [cells, of_apron] = FaceCellsOf(block, up);
      block.marks.of_tile[up] |= cells;
      add(block.column + 1, block.row * Block::kUp + up, of_apron);
    }
  }
}

constexpr int kPointsOfGroup = RowGroups::kRows * Tile::kSide;

struct TileToCommit {
  TouchedTile<uint16_t> sums;
  const StoredTile* stored;  // null where there is none yet
};

void Prefetch(const TileToCommit& tile, const ReadSection& section) {
  const Tile* const content = tile.stored == nullptr ? nullptr : tile.stored->TryRead(section);
  if (content == nullptr) return;
  constexpr int kPointsPerCacheLine = 64 / sizeof(ControlPoint);
  for (int k = 0; k < Tile::kSize; k += kPointsPerCacheLine) {
    if ((tile.sums.groups >> (k / kPointsOfGroup) & 1) != 0) {
      __builtin_prefetch(&content->control_points[k]);
    }
  }
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

template <typename Line>
void LinesByAxis<Line>::MakeSpace(size_t count) {
  const size_t needed = std::max(num_steep, num_shallow) + count + 1;
  if (steep.size() >= needed) return;
  steep.resize(needed);
  shallow.resize(needed);
}

void ScanLines::Add(absl::Span<const PlacedBeam> beams, absl::Span<const Face> faces_of_beams,
                    double knots_per_m, const ScanKernel& kernel) {
  free.MakeSpace(beams.size());
  faces.MakeSpace(beams.size());
  const ScanKernel::FaceLineCounts counts =
      kernel.set_face_lines(MemoryOf(beams), faces_of_beams.data(), beams.size(), knots_per_m,
                            &free.steep[free.num_steep], &free.shallow[free.num_shallow],
                            &faces.steep[faces.num_steep], &faces.shallow[faces.num_shallow]);
  free.num_steep += counts.free.steep;
  free.num_shallow += counts.free.shallow;
  faces.num_steep += counts.face.steep;
  faces.num_shallow += counts.face.shallow;
}

void ScanLines::Clear() {
  free.Clear();
  faces.Clear();
}

int32_t& ScanScratch::At(int32_t i, int32_t j) {
  return Touch(log_odds_.upright, i >> 5, j >> 5)[(j & 31) * SumBlock<int32_t>::kStride + (i & 31)];
}

void ScanScratch::AddFreeLines(absl::Span<const PlacedBeam> beams, const FreeLineModel& model,
                               const FreeLineTable<int32_t>& table) {
  LinesByAxis<FreeLine>& lines = lines_.free;
  lines.MakeSpace(beams.size());
  FreeLine* const steep = &lines.steep[lines.num_steep];
  FreeLine* const shallow = &lines.shallow[lines.num_shallow];
  const LineCounts counts = kernel_.set_lines(MemoryOf(beams), beams.size(), model, steep, shallow);
  kernel_.add_lines(steep, counts.steep, table.data(), log_odds_.upright);
  kernel_.add_lines(shallow, counts.shallow, table.data(), log_odds_.transposed);
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
  AddUnsettledLines(commit);
  ForEachTouched(faces_.upright, [&](TouchedTile<FaceSum> tile) {
    Touch(free_.upright, tile.tx, tile.ty, tile.groups);
  });
  std::vector<TileToCommit> touched;
  ForEachTouched(free_.upright, [&](TouchedTile<uint16_t> tile) {
    touched.push_back({tile, commit.tiles.tree().Find({tile.tx, tile.ty})});
  });
  const ReadSection section;  // for what leaves memory meanwhile
  for (size_t n = 0; n < touched.size(); ++n) {
    // Those of large maps are far.
    if (n + 1 < touched.size()) Prefetch(touched[n + 1], section);
    const auto& [tile, stored] = touched[n];
    const TileKey key{tile.tx, tile.ty};
    SumBlock<FaceSum>* const faces =
        faces_.upright.Find(tile.tx, tile.ty >> SumBlock<FaceSum>::kUpBits);
    const int up = tile.ty & (SumBlock<FaceSum>::kUp - 1);
    const Tile* const from = stored == nullptr ? &kUntouched : stored->TryRead(section);
    // What cannot be read, which its source tells, stays as it is: no scan writes over it.
    const bool is_readable = from != nullptr;
    TileCells settled = stored == nullptr ? 0 : stored->SettledCells();
    // Also where the tile is not taken: it clears the sums.
    const bool is_changed = kernel_.commit_distances(
        tile.sums, tile.groups, faces == nullptr ? nullptr : faces->TileAt(0, up),
        faces == nullptr ? 0 : faces->marks.of_tile[up], commit.limits,
        (is_readable ? *from : kUntouched).control_points.data(), result.control_points.data(),
        settled);
    if (!is_changed || !is_readable || !commit.is_taken(key)) continue;
    for (int group = 0; group < RowGroups::kPerTile; ++group) {
      if ((tile.groups >> group & 1) != 0) continue;
      const int first = group * kPointsOfGroup;
      std::memcpy(&result.control_points[first], &from->control_points[first],
                  kPointsOfGroup * sizeof(ControlPoint));
    }
    StoredTile& edited = commit.tiles.Edit(key, commit.revision);
    edited.Edit() = result;
    edited.SetSettledCells(settled);
  }
  free_.upright.Clear();
  faces_.upright.Clear();
}

void ScanScratch::AddUnsettledLines(const Commit& commit) {
  static const FreeLineTable<uint16_t> free_table(SignedDistance::kWeightPerKnot,
                                                  Footprint::kBasis);
  static const FaceLineTable face_table(SignedDistance::kWeightPerKnot);
  // Faces first: where there are some, nothing is settled.
  kernel_.add_faces(lines_.faces.steep.data(), lines_.faces.num_steep, face_table.data(),
                    faces_.upright);
  kernel_.add_faces(lines_.faces.shallow.data(), lines_.faces.num_shallow, face_table.data(),
                    faces_.transposed);
  CollectFaceCells(faces_.transposed, faces_.upright);
  Collect(kernel_.faces, faces_);

  const auto add = [&](const std::vector<FreeLine>& lines, size_t count, SumPlane<uint16_t>& plane,
                       bool is_transposed) {
    plane.OnAdd([&](SumBlock<uint16_t>& block) { MarkSettled(commit, is_transposed, block); });
    kernel_.add_free_lines(lines.data(), count, free_table.data(), plane);
    plane.OnAdd(nullptr);
  };
  add(lines_.free.steep, lines_.free.num_steep, free_.upright, false);
  add(lines_.free.shallow, lines_.free.num_shallow, free_.transposed, true);
  lines_.Clear();
  Collect(kernel_.free, free_);
}

void ScanScratch::MarkSettled(const Commit& commit, bool is_transposed,
                              SumBlock<uint16_t>& block) const {
  using Block = SumBlock<uint16_t>;
  uint64_t cells[SettledCells::kRows] = {};
  const auto key_of = [&](int across, int up) {
    const int32_t x = block.column * Block::kAcross + across;
    const int32_t y = block.row * Block::kUp + up;
    return is_transposed ? TileKey{y, x} : TileKey{x, y};
  };
  const auto mark = [&](TileKey key, const TileTree::Entry& entry) {
    TileCells left_out = entry.tile->SettledCells();
    if (left_out == 0) return;
    using Faces = SumBlock<FaceSum>;
    const Faces* const faces = faces_.upright.Find(key.tx, key.ty >> Faces::kUpBits);
    if (faces != nullptr) left_out &= ~faces->marks.of_tile[key.ty & (Faces::kUp - 1)];
    if (is_transposed) {
      left_out = Transposed(left_out);
      std::swap(key.tx, key.ty);
    }
    const int across = key.tx - block.column * Block::kAcross;
    const int up = key.ty - block.row * Block::kUp;
    for (int k = 0; k < 8; ++k) cells[8 * up + k] |= (left_out >> (8 * k) & 255) << (8 * across);
  };
  const bool are_limits_beyond = commit.limits.min < kFreeControlPoint && commit.limits.max >= 0;
  if (are_limits_beyond) {
    // With the apron.
    commit.tiles.tree().ForEachIn(key_of(0, 0), key_of(Block::kAcross, Block::kUp - 1), mark);
  }
  block.marks.Set(cells);
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
