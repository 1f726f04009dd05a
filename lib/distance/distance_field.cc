#include "lib/distance/distance_field.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <numbers>
#include <set>

#include "absl/container/flat_hash_set.h"
#include "lib/query/footprint.h"
#include "lib/query/obstacle_search.h"
#include "lib/tiles/key_tree_impl.h"

namespace splinemap {

template class KeyTree<DistanceTile>;
template class KeyTreeEditor<DistanceTile>;

namespace {

constexpr int kUnits = Site::kUnits;
constexpr int kTileUnits = Tile::kSide * kUnits;
constexpr int kBlockUnits = VertexBlock::kSide * kUnits;
constexpr int kSquaresOfBlock = VertexBlock::kSide * ObstacleSquares::kPerKnot;
constexpr double kMaxDoubt = 0.625 * kUnits;

using Row = ObstacleSquares::Row;
using Offset = DistanceTile::Offset;

VertexBlock BlockOf(int block) {
  return {VertexBlock::kSide * (block % DistanceTile::kBlocks),
          VertexBlock::kSide * (block / DistanceTile::kBlocks)};
}

// Between [a0, a1] and [b0, b1].
int32_t Gap(int32_t a0, int32_t a1, int32_t b0, int32_t b1) {
  return std::max({a0 - b1, b0 - a1, 0});
}

int32_t Square(int32_t x) { return x * x; }

// What at least is between the vertices of a block and the squares of one that is so many farther.
int32_t GapOfBlocks(int blocks) {
  return blocks == 0 ? 0 : kBlockUnits * (std::abs(blocks) - 1) + 1;
}

Site SiteAt(int x, int y) { return {static_cast<int16_t>(x), static_cast<int16_t>(y)}; }

Site CentreOf(int x, int y) { return SiteAt(2 * x + 1, 2 * y + 1); }

// Calls f(x) for each bit of a row.
template <typename Function>
void ForEachBit(uint32_t bits, Function f) {
  for (; bits != 0; bits &= bits - 1) f(std::countr_zero(bits));
}

// Of a block, in the units of sites.
Site VertexAt(const VertexBlock& block, int vertex) {
  return SiteAt(kUnits * (block.x0 + vertex % VertexBlock::kSide),
                kUnits * (block.y0 + vertex / VertexBlock::kSide));
}

void PutOffsets(const BlockOffsets& of_block, Offset* offsets) {
  for (int y = 0; y < VertexBlock::kSide; ++y) {
    std::copy_n(&of_block[VertexBlock::kSide * y], VertexBlock::kSide, offsets + Tile::kSide * y);
  }
}

uint32_t PartOf(Row row, int bx) { return static_cast<uint32_t>(row >> (kSquaresOfBlock * bx)); }

}  // namespace

DistancesQuery::Distance DistanceField::At(const Eigen::Vector2d& point_m) const {
  const DistancesQuery::Distance far{options_.max_distance_m, Eigen::Vector2d::Zero()};
  const DistancesQuery::Distance unknown =
      options_.unknown == UnknownPolicy::kBlocked ? DistancesQuery::Distance() : far;
  const double knot_interval_m = map_->options.knot_interval_m;
  const auto x = LocateKnot(point_m.x(), knot_interval_m);
  const auto y = LocateKnot(point_m.y(), knot_interval_m);
  if (!x || !y) return unknown;
  const TileKey key = TileOf(x->index, y->index);
  const DistanceTile* tile = tiles_.Find(key);
  if (tile == nullptr) return unknown;
  // Squares of distances in eighths: of the nearest, and the least that it can be.
  double most = std::numeric_limits<double>::infinity();
  double least = -kUnits * kUnits * (x->t * (1 - x->t) + y->t * (1 - y->t));
  Eigen::Vector2d away = Eigen::Vector2d::Zero();
  const int index = IndexInTile(x->index, y->index);
  const bool is_in_tile = TileOf(x->index + 1, y->index + 1) == key;
  for (int k = 0; k < 4; ++k) {
    const int right = k % 2;
    const int up = k / 2;
    const Offset offset = is_in_tile ? tile->nearest[index + right + Tile::kSide * up]
                                     : OffsetAt(key, *tile, x->index + right, y->index + up);
    if (offset.x == Offset::kNone) return far;
    const Eigen::Vector2d from(kUnits * (x->t - right) - offset.x, kUnits * (y->t - up) - offset.y);
    const double squared = from.squaredNorm();
    if (squared < most) {
      most = squared;
      away = from;
    }
    least += (right == 1 ? x->t : 1 - x->t) * (up == 1 ? y->t : 1 - y->t) *
             (offset.x * offset.x + offset.y * offset.y);
  }
  const double at_most = std::sqrt(most);
  double doubt = at_most - std::sqrt(std::max(least, 0.0));
  if (doubt > kMaxDoubt) {
    // If the nearest is 1 knot interval away or more, of some vertex the nearest is less than 0.62
    // farther, which is least where the point lies between two vertices and that across. If it is
    // nearer, that is less than 1.62 away.
    if (at_most < kUnits + kMaxDoubt) return Search(point_m);
    doubt = kMaxDoubt;
  }
  const double distance_m = (at_most - doubt / 2) * (knot_interval_m / kUnits);
  if (distance_m >= options_.max_distance_m) return far;
  if (at_most == 0) return {};
  return {distance_m, away / at_most};
}

// Of a vertex in the tile or next to it.
Offset DistanceField::OffsetAt(TileKey home, const DistanceTile& tile, int32_t i, int32_t j) const {
  const TileKey key = TileOf(i, j);
  const DistanceTile* at = key == home ? &tile : tiles_.Find(key);
  if (at != nullptr) return at->nearest[IndexInTile(i, j)];
  return options_.unknown == UnknownPolicy::kBlocked ? Offset{-1, -1} : Offset();
}

DistancesQuery::Distance DistanceField::Search(const Eigen::Vector2d& point_m) const {
  ObstacleSearch search(bounds_, options_.occupied_log_odds, options_.unknown);
  return FindDistance(search, point_m, options_.max_distance_m, map_->options.knot_interval_m);
}

DistanceField DistanceFieldEditor::Update(std::shared_ptr<const MapView> map) {
  const bool goes_on = nothing_near_ != nullptr && map->tiles.lineage() == map_->tiles.lineage() &&
                       map->tiles.version() >= map_->tiles.version() &&
                       map->options.knot_interval_m == map_->options.knot_interval_m;
  if (!goes_on) BeginAnew(*map);
  bounds_.Use(map);
  absl::flat_hash_map<TileKey, BlockMask> marked;
  const std::vector<Change> changes = UpdateObstacles(*map, marked);
  UpdateRims(changes);
  // What came first: a vertex for which it is nearer than what went does not have to look around.
  for (const bool came : {true, false}) {
    for (const Change& change : changes) {
      if (change.came == came) UpdateNear(change, marked);
    }
    for (const auto& [key, blocks] : marked) FillTile(key, blocks);
    marked.clear();
  }
  map_ = std::move(map);

  DistanceField field;
  field.options_ = options_;
  field.options_.max_distance_m = std::min(
      options_.max_distance_m, DistanceFieldOptions::kMaxReach * map_->options.knot_interval_m);
  field.map_ = map_;
  field.bounds_ = bounds_;
  field.tiles_ = tiles_.Freeze();
  return field;
}

void DistanceFieldEditor::BeginAnew(const MapView& map) {
  map_ = std::make_shared<const MapView>();
  obstacles_.clear();
  obstacles_box_ = {};
  tiles_ = KeyTreeEditor<DistanceTile>();
  const double reach = std::min(options_.max_distance_m / map.options.knot_interval_m,
                                DistanceFieldOptions::kMaxReach);
  // From a point that is nearer than that, the vertices around it are not farther than a diagonal.
  reach_ = static_cast<int32_t>(std::ceil(kUnits * (reach + std::numbers::sqrt2)));
  reach_tiles_ = reach_ / kTileUnits + 1;
  DistanceTile nothing_near;
  nothing_near.longest.fill(Square(reach_));
  nothing_near_ = std::make_shared<const DistanceTile>(nothing_near);
}

const ObstacleSquares& DistanceFieldEditor::SquaresAt(TileKey key) const {
  static const ObstacleSquares none;
  static const ObstacleSquares all = ObstacleSquares::All();
  const auto found = obstacles_.find(key);
  if (found != obstacles_.end()) return found->second->squares;
  return options_.unknown == UnknownPolicy::kBlocked ? all : none;
}

std::vector<DistanceFieldEditor::Change> DistanceFieldEditor::UpdateObstacles(
    const MapView& map, absl::flat_hash_map<TileKey, BlockMask>& marked) {
  absl::flat_hash_map<TileKey, CellMask> changed_points;
  std::set<TileKey> touched;
  map.tiles.ForEachChanged(map_->tiles.version(), [&](TileKey key, const TileTree::Entry& entry) {
    static const Tile kUntouched;
    const std::shared_ptr<const Tile> before = FindTile(map_->tiles, key);
    changed_points[key] =
        ChangedPoints(before == nullptr ? kUntouched : *before, *entry.tile->Get());
    ForEachAround(key, [&](TileKey beside) { touched.insert(beside); });
  });
  std::vector<Change> changes;
  changed_.clear();
  const ObstacleRasterizer finder(options_.occupied_log_odds * kUnitsPerLogOdds, options_.unknown);
  for (const TileKey key : touched) {
    if (options_.unknown == UnknownPolicy::kBlocked && tiles_.tree().Find(key) == nullptr) {
      marked[key] = ~BlockMask{0};
    }
    const CellMask cells = ChangedCells(key, [&](TileKey at) -> const CellMask& {
      static const CellMask kNone{};
      const auto found = changed_points.find(at);
      return found == changed_points.end() ? kNone : found->second;
    });
    const bool is_known = options_.unknown == UnknownPolicy::kFree || obstacles_.contains(key);
    if (is_known && cells == CellMask()) continue;
    const ObstacleSquares& before = SquaresAt(key);
    ObstacleSquares squares = before;
    finder.Update({map.tiles, key}, cells, squares);
    if (is_known && squares == before) continue;
    AddChanges(key, before, squares, changes);
    if (options_.unknown == UnknownPolicy::kFree && squares.IsEmpty()) {
      obstacles_.erase(key);
      continue;
    }
    std::unique_ptr<Obstacles>& obstacles = obstacles_[key];
    if (obstacles == nullptr) obstacles = std::make_unique<Obstacles>();
    obstacles->squares = squares;
    obstacles_box_.Add(key);
  }
  return changes;
}

void DistanceFieldEditor::AddChanges(TileKey key, const ObstacleSquares& before,
                                     const ObstacleSquares& after, std::vector<Change>& changes) {
  std::array<Row, kBlocks> differ{};  // by row of blocks
  for (int y = 0; y < ObstacleSquares::kSide; ++y) {
    differ[y / kSquaresOfBlock] |= before.rows[y] ^ after.rows[y];
  }
  for (int n = 0; n < 2 * kBlocks * kBlocks; ++n) {
    const int block = n / 2;
    if (PartOf(differ[block / kBlocks], block % kBlocks) == 0) continue;
    Change change{.tile = key, .came = n % 2 == 1, .begin = static_cast<int>(changed_.size())};
    const ObstacleSquares& with = change.came ? after : before;
    const ObstacleSquares& without = change.came ? before : after;
    for (int k = 0; k < kSquaresOfBlock; ++k) {
      const int y = kSquaresOfBlock * (block / kBlocks) + k;
      const int x0 = kSquaresOfBlock * (block % kBlocks);
      ForEachBit(PartOf(with.rows[y] & ~without.rows[y], block % kBlocks),
                 [&](int x) { changed_.push_back(CentreOf(x0 + x, y)); });
    }
    change.end = static_cast<int>(changed_.size());
    if (change.begin == change.end) continue;
    change.low = change.high = changed_[change.begin];
    for (int k = change.begin; k < change.end; ++k) {
      change.low = {std::min(change.low.x, changed_[k].x), std::min(change.low.y, changed_[k].y)};
      change.high = {std::max(change.high.x, changed_[k].x),
                     std::max(change.high.y, changed_[k].y)};
    }
    changes.push_back(change);
  }
}

// The squares of a tile and those next to it.
class DistanceFieldEditor::TileNeighborhood {
 public:
  TileNeighborhood(const DistanceFieldEditor& editor, TileKey key) {
    for (int k = 0; k < 9; ++k) {
      tiles_[k] = &editor.SquaresAt({key.tx + k % 3 - 1, key.ty + k / 3 - 1});
    }
  }

  // Row y in [-1, 128].
  Row At(int y) const { return RowOf(1, y); }
  // By square, the one on its left, or right.
  Row LeftOf(int y) const { return RowOf(1, y) << 1 | RowOf(0, y) >> (kSide - 1); }
  Row RightOf(int y) const { return RowOf(1, y) >> 1 | RowOf(2, y) << (kSide - 1); }

  // The squares of a block of row bx, and before these the one on its left.
  uint64_t FromLeftOf(int y, int bx) const {
    return uint64_t{PartOf(At(y), bx)} << 1 | (PartOf(LeftOf(y), bx) & 1);
  }

  // Those that do not lie between four others.
  Row Rim(int y) const { return At(y) & ~(LeftOf(y) & RightOf(y) & At(y - 1) & At(y + 1)); }

 private:
  static constexpr int kSide = ObstacleSquares::kSide;

  Row RowOf(int tx, int y) const {
    const int ty = y < 0 ? 0 : y < kSide ? 1 : 2;
    return tiles_[3 * ty + tx]->rows[y & (kSide - 1)];
  }

  std::array<const ObstacleSquares*, 9> tiles_;
};

void DistanceFieldEditor::UpdateRims(absl::Span<const Change> changes) {
  absl::flat_hash_set<TileKey> beside;
  for (const Change& change : changes) {
    const auto [tx, ty] = change.tile;
    beside.insert({tx, ty});
    if (change.low.x == 1) beside.insert({tx - 1, ty});
    if (change.low.y == 1) beside.insert({tx, ty - 1});
    if (change.high.x == kTileUnits - 1) beside.insert({tx + 1, ty});
    if (change.high.y == kTileUnits - 1) beside.insert({tx, ty + 1});
  }
  for (const TileKey key : beside) {
    const auto found = obstacles_.find(key);
    if (found == obstacles_.end()) continue;
    Obstacles& obstacles = *found->second;
    obstacles.boundary.clear();
    const TileNeighborhood surroundings(*this, key);
    std::array<Row, ObstacleSquares::kSide> rows;
    std::array<Row, kBlocks> any{};  // by row of blocks
    for (int y = 0; y < ObstacleSquares::kSide; ++y) {
      rows[y] = surroundings.At(y) == 0 ? 0 : surroundings.Rim(y);
      any[y / kSquaresOfBlock] |= rows[y];
    }
    for (int block = 0; block < kBlocks * kBlocks; ++block) {
      const int x0 = kSquaresOfBlock * (block % kBlocks);
      const int y0 = kSquaresOfBlock * (block / kBlocks);
      const int y1 = PartOf(any[block / kBlocks], block % kBlocks) == 0 ? y0 : y0 + kSquaresOfBlock;
      for (int y = y0; y < y1; ++y) {
        ForEachBit(PartOf(rows[y], block % kBlocks),
                   [&](int x) { obstacles.boundary.push_back(CentreOf(x0 + x, y)); });
      }
      obstacles.ends[block + 1] = static_cast<int>(obstacles.boundary.size());
    }
  }
}

// Takes squares that came where they are the nearest, and those that went away. Marks the blocks
// whose vertices then have to look around: those with a vertex that had one that went, and those of
// new tiles.
void DistanceFieldEditor::UpdateNear(const Change& change,
                                     absl::flat_hash_map<TileKey, BlockMask>& marked) {
  const auto sites = absl::MakeConstSpan(changed_).subspan(change.begin, change.end - change.begin);
  for (int dy = -reach_tiles_; dy <= reach_tiles_; ++dy) {
    for (int dx = -reach_tiles_; dx <= reach_tiles_; ++dx) {
      const TileKey key{change.tile.tx + dx, change.tile.ty + dy};
      const int32_t x = Gap(kTileUnits * dx, kTileUnits * (dx + 1), change.low.x, change.high.x);
      const int32_t y = Gap(kTileUnits * dy, kTileUnits * (dy + 1), change.low.y, change.high.y);
      if (Square(x) + Square(y) > Square(reach_) || !IsInRange(key)) continue;
      if (options_.unknown == UnknownPolicy::kBlocked && !obstacles_.contains(key)) continue;
      const DistanceTile* found = tiles_.tree().Find(key);
      if (found == nullptr && !change.came) continue;
      const DistanceTile* tile = found == nullptr ? nothing_near_.get() : found;
      BlockMask near = BlocksNear(change, key, *tile);
      if (near == 0) continue;
      BlockMask& blocks = marked[key];
      if (found == nullptr) near &= ~blocks;
      for (; near != 0; near &= near - 1) {
        const int block = std::countr_zero(near);
        const VertexBlock vertices = BlockOf(block);
        const VertexBlock from_change{Tile::kSide * dx + vertices.x0,
                                      Tile::kSide * dy + vertices.y0};
        const int index = IndexInTile(vertices.x0, vertices.y0);
        // Most squares are hidden from all of the block by what is near one of its vertices.
        const int middle = VertexBlock::kSize / 2 + VertexBlock::kSide / 2;
        absl::Span<const Site> seen = sites;
        const Offset offset = tile->nearest[index + IndexInTile(4, 4)];
        if (offset.x != Offset::kNone && offset != kLost) {
          const Site vertex = VertexAt(from_change, middle);
          seen = some_sites_.NotHidden(
              sites, {VertexAt(from_change, 0), VertexAt(from_change, VertexBlock::kSize - 1)},
              SiteAt(vertex.x + offset.x, vertex.y + offset.y));
          if (seen.empty()) continue;
        }
        BlockOffsets offsets;
        int32_t longest = tile->longest[block];
        if (change.came) {
          NearestSites nearest(NearestSites::Of::kAllVertices, &tile->nearest[index],
                               Square(reach_));
          if (!nearest.Add(seen, from_change)) continue;
          offsets = nearest.Offsets();
          longest = nearest.LongestSquared();
        } else if (!TakeAway(seen, from_change, &tile->nearest[index], offsets)) {
          continue;
        }
        if (found == nullptr || !change.came) blocks |= near & -near;
        if (found == nullptr) continue;
        DistanceTile& edited = tiles_.Edit(key, 0);
        PutOffsets(offsets, &edited.nearest[index]);
        edited.longest[block] = longest;
        tile = &edited;
      }
    }
  }
}

// Those with a vertex that may be no farther from a square of the change than from what it has.
DistanceFieldEditor::BlockMask DistanceFieldEditor::BlocksNear(const Change& change, TileKey key,
                                                               const DistanceTile& tile) {
  constexpr int32_t kWidth = kBlockUnits - kUnits;
  std::array<int32_t, kBlocks> squares_x;
  std::array<int32_t, kBlocks> squares_y;
  for (int k = 0; k < kBlocks; ++k) {
    const int32_t x0 = kTileUnits * (key.tx - change.tile.tx) + kBlockUnits * k;
    const int32_t y0 = kTileUnits * (key.ty - change.tile.ty) + kBlockUnits * k;
    squares_x[k] = Square(Gap(x0, x0 + kWidth, change.low.x, change.high.x));
    squares_y[k] = Square(Gap(y0, y0 + kWidth, change.low.y, change.high.y));
  }
  BlockMask blocks = 0;
  for (int block = 0; block < kBlocks * kBlocks; ++block) {
    const bool is_near =
        squares_x[block % kBlocks] + squares_y[block / kBlocks] <= tile.longest[block];
    blocks |= static_cast<BlockMask>(is_near << block);
  }
  return blocks;
}

void DistanceFieldEditor::FillTile(TileKey key, BlockMask blocks) {
  if (blocks == 0) return;
  const DistanceTile* before = tiles_.tree().Find(key);
  DistanceTile tile = before == nullptr ? *nothing_near_ : *before;
  FindObstaclesAround(key);
  const TileNeighborhood surroundings(*this, key);
  for (int block = 0; block < kBlocks * kBlocks; ++block) {
    if ((blocks >> block & 1) == 0) continue;
    const VertexBlock vertices = BlockOf(block);
    if (before == nullptr) {
      BlockOffsets all_lost;
      all_lost.fill(kLost);
      PutOffsets(all_lost, &tile.nearest[IndexInTile(vertices.x0, vertices.y0)]);
    }
    FillBlock(vertices, surroundings, tile);
  }
  if (tile != *nothing_near_) {
    tiles_.Edit(key, 0) = tile;
  } else if (before != nullptr || options_.unknown == UnknownPolicy::kBlocked) {
    tiles_.Put(key, nothing_near_, 0);
  }
}

// Finds what is nearest to the vertices that lost what they had.
void DistanceFieldEditor::FillBlock(const VertexBlock& block, const TileNeighborhood& surroundings,
                                    DistanceTile& tile) {
  Offset* offsets = &tile.nearest[IndexInTile(block.x0, block.y0)];
  const int bx = block.x0 / VertexBlock::kSide;
  uint64_t lost = 0;
  for (int y = 0; y < VertexBlock::kSide; ++y) {
    // The squares that have a vertex as their corner: no other is nearer, and not all of them have
    // to be at the boundary.
    const int above = ObstacleSquares::kPerKnot * (block.y0 + y);
    const uint64_t low_squares = surroundings.FromLeftOf(above - 1, bx);
    const uint64_t high_squares = surroundings.FromLeftOf(above, bx);
    for (int x = 0; x < VertexBlock::kSide; ++x) {
      Offset& offset = offsets[Tile::kSide * y + x];
      if (offset != kLost) continue;
      const int at = ObstacleSquares::kPerKnot * x;
      const uint64_t corners = (low_squares >> at & 3) | (high_squares >> at & 3) << 2;
      if (corners == 0) {
        lost |= uint64_t{1} << (VertexBlock::kSide * y + x);
        continue;
      }
      const int first = std::countr_zero(corners);
      offset = {static_cast<int16_t>(first % 2 == 0 ? -1 : 1),
                static_cast<int16_t>(first < 2 ? -1 : 1)};
    }
  }
  if (lost != 0) {
    NearestSites nearest(NearestSites::Of::kLostOnes, offsets, Square(reach_));
    AddSitesOfNeighbors(block, lost, tile, nearest);
    AddSitesAround(block, lost, nearest);
    PutOffsets(nearest.Offsets(), offsets);
  }
  tile.longest[kBlocks * (block.y0 / VertexBlock::kSide) + bx] =
      NearestSites(NearestSites::Of::kAllVertices, offsets, Square(reach_)).LongestSquared();
}

// Those of the tiles within reach.
void DistanceFieldEditor::FindObstaclesAround(TileKey key) {
  around_ = {std::max(key.tx - reach_tiles_, obstacles_box_.tx0),
             std::max(key.ty - reach_tiles_, obstacles_box_.ty0),
             std::min(key.tx + reach_tiles_ + 1, obstacles_box_.tx1),
             std::min(key.ty + reach_tiles_ + 1, obstacles_box_.ty1)};
  obstacles_around_.clear();
  for (int32_t ty = around_.ty0; ty < around_.ty1; ++ty) {
    for (int32_t tx = around_.tx0; tx < around_.tx1; ++tx) {
      const auto found = obstacles_.find({tx, ty});
      obstacles_around_.push_back(found == obstacles_.end() ? nullptr : found->second.get());
    }
  }
  around_ = {around_.tx0 - key.tx, around_.ty0 - key.ty, around_.tx1 - key.tx,
             around_.ty1 - key.ty};
}

// What vertices beside those that lost theirs have is near these, too: it bounds what else may be.
void DistanceFieldEditor::AddSitesOfNeighbors(const VertexBlock& block, uint64_t lost,
                                              const DistanceTile& tile, NearestSites& nearest) {
  constexpr uint64_t kFirstColumn = 0x0101010101010101;
  constexpr uint64_t kLastColumn = kFirstColumn << (VertexBlock::kSide - 1);
  struct Side {
    int dx;
    int dy;
    uint64_t lost_there;
  };
  const Side sides[] = {{1, 0, (lost & ~kFirstColumn) >> 1},
                        {-1, 0, (lost & ~kLastColumn) << 1},
                        {0, 1, lost >> VertexBlock::kSide},
                        {0, -1, lost << VertexBlock::kSide}};
  sites_.clear();
  for (const Side& side : sides) {
    for (uint64_t rest = lost & ~side.lost_there; rest != 0; rest &= rest - 1) {
      const int vertex = std::countr_zero(rest);
      const int x = block.x0 + vertex % VertexBlock::kSide + side.dx;
      const int y = block.y0 + vertex / VertexBlock::kSide + side.dy;
      if (x < 0 || y < 0 || x >= Tile::kSide || y >= Tile::kSide) continue;
      const Offset& offset = tile.nearest[IndexInTile(x, y)];
      if (offset.x == Offset::kNone || offset == kLost) continue;
      const Site site = SiteAt(kUnits * x + offset.x, kUnits * y + offset.y);
      if (sites_.empty() || sites_.back() != site) sites_.push_back(site);
    }
  }
  nearest.Add(sites_, block);
}

// All that can be nearest to a vertex that lost what it had: ring by ring of the blocks around it,
// until what is there is farther from all of them than the nearest so far.
void DistanceFieldEditor::AddSitesAround(const VertexBlock& block, uint64_t lost,
                                         NearestSites& nearest) {
  uint64_t columns = lost | lost >> 32;
  columns |= columns >> 16;
  columns = (columns | columns >> 8) & 0xFF;
  const int first_row = std::countr_zero(lost) / VertexBlock::kSide;
  const int last_row = (63 - std::countl_zero(lost)) / VertexBlock::kSide;
  const Site low = VertexAt(block, VertexBlock::kSide * first_row + std::countr_zero(columns));
  const Site high = VertexAt(block, VertexBlock::kSide * last_row + 63 - std::countl_zero(columns));
  // One of them, in the middle.
  uint64_t upper = lost;
  for (int n = std::popcount(lost) / 2; n > 0; --n) upper &= upper - 1;
  const int middle = std::countr_zero(upper);
  const int bx = block.x0 / VertexBlock::kSide;
  const int by = block.y0 / VertexBlock::kSide;
  // Of the blocks around, from this one.
  const int left = kBlocks * around_.tx0 - bx;
  const int right = kBlocks * around_.tx1 - bx - 1;
  const int bottom = kBlocks * around_.ty0 - by;
  const int top = kBlocks * around_.ty1 - by - 1;
  const int first = std::max({left, -right, bottom, -top, 0});
  const int last = std::max({-left, right, -bottom, top});
  int32_t end_squared = nearest.LongestSquared();
  for (int ring = first; ring <= last && Square(GapOfBlocks(ring)) <= end_squared; ++ring) {
    for (int dy = std::max(-ring, bottom); dy <= std::min(ring, top); ++dy) {
      const int32_t y0 = kBlockUnits * (by + dy);
      const int32_t squared_y = Square(Gap(y0 + 1, y0 + kBlockUnits - 1, low.y, high.y));
      if (squared_y > end_squared) continue;
      const int step = std::abs(dy) == ring ? 1 : 2 * ring;
      for (int dx = -ring; dx <= ring; dx += step) {
        if (dx < left || dx > right) continue;
        const int32_t x0 = kBlockUnits * (bx + dx);
        const int32_t squared_x = Square(Gap(x0 + 1, x0 + kBlockUnits - 1, low.x, high.x));
        if (squared_x + squared_y > end_squared) continue;
        const int tx = (bx + dx) >> 2;
        const int ty = (by + dy) >> 2;
        const Obstacles* obstacles =
            obstacles_around_[(ty - around_.ty0) * (around_.tx1 - around_.tx0) + tx - around_.tx0];
        if (obstacles == nullptr) continue;
        const int k = kBlocks * ((by + dy) & (kBlocks - 1)) + ((bx + dx) & (kBlocks - 1));
        const int begin = obstacles->ends[k];
        const int count = obstacles->ends[k + 1] - begin;
        if (count == 0) continue;
        const absl::Span<const Site> sites(&obstacles->boundary[begin], static_cast<size_t>(count));
        const int x_there = kTileUnits * tx;
        const int y_there = kTileUnits * ty;
        Site other = sites[sites.size() / 2];
        const Offset offset = nearest.OffsetOf(middle);
        if (offset.x != Offset::kNone) {
          const Site vertex = VertexAt(block, middle);
          other = SiteAt(vertex.x + offset.x - x_there, vertex.y + offset.y - y_there);
        }
        const VertexBox box{SiteAt(low.x - x_there, low.y - y_there),
                            SiteAt(high.x - x_there, high.y - y_there)};
        const VertexBlock from_there{block.x0 - Tile::kSide * tx, block.y0 - Tile::kSide * ty};
        if (nearest.Add(some_sites_.NotHidden(sites, box, other), from_there)) {
          end_squared = nearest.LongestSquared();
        }
      }
    }
  }
}

}  // namespace splinemap
