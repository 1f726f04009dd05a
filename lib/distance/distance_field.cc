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

Site CentreOf(int x, int y) { return {2 * x + 1, 2 * y + 1}; }

// Calls f(x) for each bit of a row.
template <typename Function>
void ForEachBit(uint32_t bits, Function f) {
  for (; bits != 0; bits &= bits - 1) f(std::countr_zero(bits));
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
  for (int k = 0; k < 4; ++k) {
    const int right = k % 2;
    const int up = k / 2;
    const Offset offset = OffsetAt(key, *tile, x->index + right, y->index + up);
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
  std::set<TileKey> around;
  map->tiles.ForEachChanged(map_->tiles.version(), [&](TileKey key, const TileTree::Entry&) {
    ForEachAround(key, [&](TileKey beside) { around.insert(beside); });
  });
  std::vector<TileKey> touched;
  for (const TileKey key : around) {
    if (bounds_.Find(key) != nullptr) touched.push_back(key);
  }

  absl::flat_hash_map<TileKey, BlockMask> marked;
  if (options_.unknown == UnknownPolicy::kBlocked) {
    for (const TileKey key : touched) {
      if (tiles_.tree().Find(key) == nullptr) marked[key] = ~BlockMask{0};
    }
  }
  const std::vector<Change> changes = UpdateObstacles(*map, touched);
  UpdateRims(changes);
  for (const Change& change : changes) MarkBlocksNear(change, marked);
  for (const auto& [key, blocks] : marked) UpdateTile(key, blocks);
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
    const MapView& map, absl::Span<const TileKey> touched) {
  std::vector<Change> changes;
  changed_.clear();
  ObstacleRasterizer finder(map.tiles, options_.occupied_log_odds * kUnitsPerLogOdds,
                            options_.unknown);
  for (const TileKey key : touched) {
    ObstacleSquares squares = SquaresAt(key);
    finder.Update(key, *bounds_.Find(key), ChangedCells(map_->tiles, map.tiles, key), squares);
    AddChanges(key, SquaresAt(key), squares, changes);
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
  for (int block = 0; block < kBlocks * kBlocks; ++block) {
    Change change;
    change.tile = key;
    change.begin = static_cast<int>(changed_.size());
    for (int k = 0; k < kSquaresOfBlock; ++k) {
      const int y = kSquaresOfBlock * (block / kBlocks) + k;
      const int x0 = kSquaresOfBlock * (block % kBlocks);
      ForEachBit(PartOf(before.rows[y] ^ after.rows[y], block % kBlocks),
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
    beside.insert({{tx, ty}, {tx - 1, ty}, {tx + 1, ty}, {tx, ty - 1}, {tx, ty + 1}});
  }
  for (const TileKey key : beside) {
    const auto found = obstacles_.find(key);
    if (found == obstacles_.end()) continue;
    Obstacles& obstacles = *found->second;
    obstacles.boundary.clear();
    const TileNeighborhood surroundings(*this, key);
    std::array<Row, ObstacleSquares::kSide> rows;
    for (int y = 0; y < ObstacleSquares::kSide; ++y) rows[y] = surroundings.Rim(y);
    for (int block = 0; block < kBlocks * kBlocks; ++block) {
      const int x0 = kSquaresOfBlock * (block % kBlocks);
      const int y0 = kSquaresOfBlock * (block / kBlocks);
      for (int y = y0; y < y0 + kSquaresOfBlock; ++y) {
        ForEachBit(PartOf(rows[y], block % kBlocks),
                   [&](int x) { obstacles.boundary.push_back(CentreOf(x0 + x, y)); });
      }
      obstacles.ends[block + 1] = static_cast<int>(obstacles.boundary.size());
    }
  }
}

void DistanceFieldEditor::MarkBlocksNear(const Change& change,
                                         absl::flat_hash_map<TileKey, BlockMask>& marked) const {
  for (int dy = -reach_tiles_; dy <= reach_tiles_; ++dy) {
    for (int dx = -reach_tiles_; dx <= reach_tiles_; ++dx) {
      const TileKey key{change.tile.tx + dx, change.tile.ty + dy};
      const int32_t x = Gap(kTileUnits * dx, kTileUnits * (dx + 1), change.low.x, change.high.x);
      const int32_t y = Gap(kTileUnits * dy, kTileUnits * (dy + 1), change.low.y, change.high.y);
      if (Square(x) + Square(y) > Square(reach_) || !IsInRange(key)) continue;
      if (options_.unknown == UnknownPolicy::kBlocked && !obstacles_.contains(key)) continue;
      const DistanceTile* tile = tiles_.tree().Find(key);
      const auto found = marked.find(key);
      const BlockMask before = found == marked.end() ? 0 : found->second;
      BlockMask blocks = before;
      for (int block = 0; block < kBlocks * kBlocks; ++block) {
        const auto bit = static_cast<BlockMask>(1 << block);
        if ((blocks & bit) != 0) continue;
        if (IsNearAny(change, key, tile == nullptr ? *nothing_near_ : *tile, block)) blocks |= bit;
      }
      if (blocks != before) marked[key] = blocks;
    }
  }
}

// Whether a vertex of the block may have something of the change as its nearest, before or after
// it: what came or went is not farther than what it has.
bool DistanceFieldEditor::IsNearAny(const Change& change, TileKey key, const DistanceTile& tile,
                                    int block) const {
  const VertexBlock vertices = BlockOf(block);
  const int32_t x0 = kTileUnits * (key.tx - change.tile.tx) + kUnits * vertices.x0;
  const int32_t y0 = kTileUnits * (key.ty - change.tile.ty) + kUnits * vertices.y0;
  const auto squared_gap = [&](const Site& low, const Site& high) {
    constexpr int32_t kWidth = kBlockUnits - kUnits;
    return Square(Gap(x0, x0 + kWidth, low.x, high.x)) +
           Square(Gap(y0, y0 + kWidth, low.y, high.y));
  };
  const int32_t longest = tile.longest[block];
  if (squared_gap(change.low, change.high) > longest) return false;
  std::array<int32_t, VertexBlock::kSize> has;
  for (int n = 0; n < VertexBlock::kSize; ++n) {
    const Offset offset = tile.nearest[IndexInTile(vertices.x0 + n % VertexBlock::kSide,
                                                   vertices.y0 + n / VertexBlock::kSide)];
    has[n] = offset.x == Offset::kNone ? Square(reach_) : Square(offset.x) + Square(offset.y);
  }
  for (int k = change.begin; k < change.end; ++k) {
    const Site& site = changed_[k];
    if (squared_gap(site, site) > longest) continue;
    std::array<int32_t, VertexBlock::kSide> squares_x;
    for (int x = 0; x < VertexBlock::kSide; ++x) squares_x[x] = Square(x0 + kUnits * x - site.x);
    int num_near = 0;
    for (int y = 0; y < VertexBlock::kSide; ++y) {
      const int32_t square_y = Square(y0 + kUnits * y - site.y);
      for (int x = 0; x < VertexBlock::kSide; ++x) {
        num_near += squares_x[x] + square_y <= has[VertexBlock::kSide * y + x] ? 1 : 0;
      }
    }
    if (num_near > 0) return true;
  }
  return false;
}

void DistanceFieldEditor::UpdateTile(TileKey key, BlockMask blocks) {
  const DistanceTile* before = tiles_.tree().Find(key);
  DistanceTile tile = before == nullptr ? *nothing_near_ : *before;
  for (int block = 0; block < kBlocks * kBlocks; ++block) {
    if ((blocks >> block & 1) != 0) UpdateBlock(key, BlockOf(block), tile);
  }
  if (tile != *nothing_near_) {
    tiles_.Edit(key, 0) = tile;
  } else if (before != nullptr || options_.unknown == UnknownPolicy::kBlocked) {
    tiles_.Put(key, nothing_near_, 0);
  }
}

void DistanceFieldEditor::UpdateBlock(TileKey key, const VertexBlock& block, DistanceTile& tile) {
  GatherSitesAround(key, block);
  LeaveOutHidden(sites_, block);
  std::array<Site, VertexBlock::kSize> nearest;
  if (!sites_.empty()) nearest = NearestSites(sites_, block);
  const TileNeighborhood surroundings(*this, key);
  int32_t longest = 0;
  for (int y = block.y0; y < block.y0 + VertexBlock::kSide; ++y) {
    // The squares that have a vertex as their corner: no other is nearer, and not all of them have
    // to be at the boundary.
    const int above = ObstacleSquares::kPerKnot * y;
    const std::array<Row, 4> corners{surroundings.LeftOf(above - 1), surroundings.At(above - 1),
                                     surroundings.LeftOf(above), surroundings.At(above)};
    for (int x = block.x0; x < block.x0 + VertexBlock::kSide; ++x) {
      Offset offset;
      int32_t squared = Square(reach_) + 1;
      if (!sites_.empty()) {
        const Site& site = nearest[VertexBlock::kSide * (y - block.y0) + x - block.x0];
        const Site way{site.x - kUnits * x, site.y - kUnits * y};
        offset = {static_cast<int16_t>(way.x), static_cast<int16_t>(way.y)};
        squared = Square(way.x) + Square(way.y);
      }
      for (int k = 3; k >= 0; --k) {
        if ((corners[k] >> (ObstacleSquares::kPerKnot * x) & 1) == 0) continue;
        offset = {static_cast<int16_t>(k % 2 == 0 ? -1 : 1), static_cast<int16_t>(k < 2 ? -1 : 1)};
        squared = 2;
      }
      const bool is_near = squared <= Square(reach_);
      tile.nearest[IndexInTile(x, y)] = is_near ? offset : Offset();
      longest = std::max(longest, is_near ? squared : Square(reach_));
    }
  }
  tile.longest[kBlocks * (block.y0 / VertexBlock::kSide) + block.x0 / VertexBlock::kSide] = longest;
}

// All that can be nearest to a vertex of the block: ring by ring of the blocks around it, until
// what is there is farther from all of them than the nearest so far.
void DistanceFieldEditor::GatherSitesAround(TileKey key, const VertexBlock& block) {
  constexpr int32_t kHalf = (kBlockUnits - kUnits) / 2;
  sites_.clear();
  const int bx = block.x0 / VertexBlock::kSide;
  const int by = block.y0 / VertexBlock::kSide;
  int32_t least = std::numeric_limits<int32_t>::max();
  double end = reach_;
  // Of the blocks that have obstacles, from this one.
  const int left = kBlocks * (obstacles_box_.tx0 - key.tx) - bx;
  const int right = kBlocks * (obstacles_box_.tx1 - key.tx) - bx - 1;
  const int low = kBlocks * (obstacles_box_.ty0 - key.ty) - by;
  const int high = kBlocks * (obstacles_box_.ty1 - key.ty) - by - 1;
  const int first = std::max({left, -right, low, -high, 0});
  const int last = std::max({-left, right, -low, high});
  for (int ring = first; ring <= last && GapOfBlocks(ring) <= end; ++ring) {
    for (int dy = std::max(-ring, low); dy <= std::min(ring, high); ++dy) {
      const int step = std::abs(dy) == ring ? 1 : 2 * ring;
      for (int dx = -ring; dx <= ring; dx += step) {
        if (dx < left || dx > right) continue;
        if (Square(GapOfBlocks(dx)) + Square(GapOfBlocks(dy)) > end * end) continue;
        const int x = bx + dx;
        const int y = by + dy;
        const int tx = x >> 2;
        const int ty = y >> 2;
        const auto found = obstacles_.find({key.tx + tx, key.ty + ty});
        if (found == obstacles_.end()) continue;
        const Obstacles& obstacles = *found->second;
        const int k = kBlocks * (y & (kBlocks - 1)) + (x & (kBlocks - 1));
        for (int n = obstacles.ends[k]; n < obstacles.ends[k + 1]; ++n) {
          const Site site{obstacles.boundary[n].x + kTileUnits * tx,
                          obstacles.boundary[n].y + kTileUnits * ty};
          sites_.push_back(site);
          const int32_t squared = Square(site.x - kUnits * block.x0 - kHalf) +
                                  Square(site.y - kUnits * block.y0 - kHalf);
          if (squared >= least) continue;
          least = squared;
          end = std::min<double>(reach_, std::sqrt(squared) + std::numbers::sqrt2 * kHalf);
        }
      }
    }
  }
}

}  // namespace splinemap
