#include "lib/distance/distance_field.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <limits>
#include <numbers>

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
static_assert(kSquaresOfBlock == 32);  // a word of ObstacleSquares
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
  changes_.clear();
  changed_.clear();
  tiles_near_.clear();
  UpdateObstacles(*map);
  UpdateRims();
  FindTilesNear();
  for (const auto& [key, changes_near] : tiles_near_) UpdateTile(key, changes_near);
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

void DistanceFieldEditor::UpdateObstacles(const MapView& map) {
  absl::flat_hash_map<TileKey, CellMask> changed_points;  // of tiles that changed, and around them
  map.tiles.ForEachChanged(map_->tiles.version(), [&](TileKey key, const TileTree::Entry& entry) {
    static const Tile kUntouched;
    const std::shared_ptr<const Tile> before = FindTile(map_->tiles, key);
    changed_points[key] =
        ChangedPoints(before == nullptr ? kUntouched : *before, *entry.tile->Get());
    ForEachAround(key, [&](TileKey beside) { changed_points.try_emplace(beside); });
  });
  const ObstacleRasterizer finder(options_.occupied_log_odds * kUnitsPerLogOdds, options_.unknown);
  for (const auto& [key, points] : changed_points) {
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
    AddChanges(key, before, squares);
    if (options_.unknown == UnknownPolicy::kFree && squares.IsEmpty()) {
      obstacles_.erase(key);
      continue;
    }
    std::unique_ptr<Obstacles>& obstacles = obstacles_[key];
    if (obstacles == nullptr) obstacles = std::make_unique<Obstacles>();
    obstacles->squares = squares;
    obstacles_box_.Add(key);
    if (!is_known) tiles_near_[key] = ChangesNear::kNoMore;
  }
}

void DistanceFieldEditor::AddChanges(TileKey key, const ObstacleSquares& before,
                                     const ObstacleSquares& after) {
  std::array<Row, kBlocks> differ{};  // by row of blocks
  for (int y = 0; y < ObstacleSquares::kSide; ++y) {
    for (int bx = 0; bx < kBlocks; ++bx) {
      differ[y / kSquaresOfBlock][bx] |= before.rows[y][bx] ^ after.rows[y][bx];
    }
  }
  for (int n = 0; n < 2 * kBlocks * kBlocks; ++n) {
    const int block = n / 2;
    if (differ[block / kBlocks][block % kBlocks] == 0) continue;
    Change change{.tile = key,
                  .block = block,
                  .came = n % 2 == 1,
                  .begin = static_cast<int>(changed_.size())};
    const ObstacleSquares& with = change.came ? after : before;
    const ObstacleSquares& without = change.came ? before : after;
    const int x0 = kSquaresOfBlock * (block % kBlocks);
    const int y0 = kSquaresOfBlock * (block / kBlocks);
    for (int y = y0; y < y0 + kSquaresOfBlock; ++y) {
      ForEachBit(with.rows[y][block % kBlocks] & ~without.rows[y][block % kBlocks],
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
    changes_.push_back(change);
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

  // Calls f(y, squares) for rows y in [y0, y1), between -1 and 129: with the squares of the block
  // in column bx, before these the one on its left, and after them the one on its right.
  template <typename Function>
  void ForEachRow(int bx, int y0, int y1, Function f) const {
    for (int y = y0; y < y1;) {
      const int ty = y < 0 ? 0 : y < ObstacleSquares::kSide ? 1 : 2;
      const Row* left = RowsOf(bx - 1, ty);
      const Row* middle = RowsOf(bx, ty);
      const Row* right = RowsOf(bx + 1, ty);
      for (const int end = std::min(y1, ObstacleSquares::kSide * ty); y < end; ++y) {
        const int k = y & (ObstacleSquares::kSide - 1);
        f(y, uint64_t{left[k][(bx - 1) & (kBlocks - 1)]} >> (kSquaresOfBlock - 1) |
                 uint64_t{middle[k][bx]} << 1 |
                 uint64_t{right[k][(bx + 1) & (kBlocks - 1)]} << (kSquaresOfBlock + 1));
      }
    }
  }

 private:
  const Row* RowsOf(int bx, int ty) const {
    const int tx = bx < 0 ? 0 : bx < kBlocks ? 1 : 2;
    return tiles_[3 * ty + tx]->rows.data();
  }

  std::array<const ObstacleSquares*, 9> tiles_;
};

// Of blocks with a square that changed or is beside one.
void DistanceFieldEditor::UpdateRims() {
  absl::flat_hash_map<TileKey, BlockMask> changed;
  const auto add = [&](TileKey key, int bx, int by) {
    changed[{key.tx + (bx >> 2), key.ty + (by >> 2)}] |=
        static_cast<BlockMask>(1 << (kBlocks * (by & (kBlocks - 1)) + (bx & (kBlocks - 1))));
  };
  for (const Change& change : changes_) {
    const int bx = change.block % kBlocks;
    const int by = change.block / kBlocks;
    add(change.tile, bx, by);
    if (change.low.x == kBlockUnits * bx + 1) add(change.tile, bx - 1, by);
    if (change.low.y == kBlockUnits * by + 1) add(change.tile, bx, by - 1);
    if (change.high.x == kBlockUnits * (bx + 1) - 1) add(change.tile, bx + 1, by);
    if (change.high.y == kBlockUnits * (by + 1) - 1) add(change.tile, bx, by + 1);
  }
  for (const auto& [key, blocks] : changed) {
    const auto found = obstacles_.find(key);
    if (found == obstacles_.end()) continue;
    Obstacles& obstacles = *found->second;
    const TileNeighborhood surroundings(*this, key);
    sites_.clear();
    BlockMask with_boundary = 0;
    int begin = 0;
    for (int block = 0; block < kBlocks * kBlocks; ++block) {
      const int end = obstacles.ends[block + 1];
      const size_t before = sites_.size();
      if ((blocks >> block & 1) == 0) {
        sites_.insert(sites_.end(), obstacles.boundary.begin() + begin,
                      obstacles.boundary.begin() + end);
      } else {
        const int x0 = kSquaresOfBlock * (block % kBlocks);
        const int y0 = kSquaresOfBlock * (block / kBlocks);
        uint64_t below = 0;
        uint64_t row = 0;
        surroundings.ForEachRow(
            block % kBlocks, y0 - 1, y0 + kSquaresOfBlock + 1, [&](int y, uint64_t above) {
              // Those that do not lie between four others.
              const uint64_t rim = row & ~(row << 1 & row >> 1 & below & above);
              if (y > y0) {
                ForEachBit(static_cast<uint32_t>(rim >> 1),
                           [&](int x) { sites_.push_back(CentreOf(x0 + x, y - 1)); });
              }
              below = row;
              row = above;
            });
      }
      begin = end;
      obstacles.ends[block + 1] = static_cast<int>(sites_.size());
      with_boundary |= static_cast<BlockMask>((sites_.size() != before) << block);
    }
    obstacles.boundary.assign(sites_.begin(), sites_.end());
    obstacles.with_boundary = with_boundary;
  }
}

// Those with a vertex that may be near something that changed.
void DistanceFieldEditor::FindTilesNear() {
  changes_near_.clear();
  const int num_changes = static_cast<int>(changes_.size());
  for (int begin = 0, end = 0; begin < num_changes; begin = end) {
    const TileKey changed = changes_[begin].tile;
    Site low = changes_[begin].low;
    Site high = changes_[begin].high;
    for (end = begin; end < num_changes && changes_[end].tile == changed; ++end) {
      low = {std::min(low.x, changes_[end].low.x), std::min(low.y, changes_[end].low.y)};
      high = {std::max(high.x, changes_[end].high.x), std::max(high.y, changes_[end].high.y)};
    }
    for (int dy = -reach_tiles_; dy <= reach_tiles_; ++dy) {
      for (int dx = -reach_tiles_; dx <= reach_tiles_; ++dx) {
        const TileKey key{changed.tx + dx, changed.ty + dy};
        const int32_t x = Gap(kTileUnits * dx, kTileUnits * (dx + 1), low.x, high.x);
        const int32_t y = Gap(kTileUnits * dy, kTileUnits * (dy + 1), low.y, high.y);
        if (Square(x) + Square(y) > Square(reach_) || !IsInRange(key)) continue;
        int& first = tiles_near_.try_emplace(key, ChangesNear::kNoMore).first->second;
        changes_near_.push_back({begin, end, first});
        first = static_cast<int>(changes_near_.size()) - 1;
      }
    }
  }
}

// Takes squares that came where they are the nearest, and those that went away; finds what is
// nearest to those vertices that had one that went.
void DistanceFieldEditor::UpdateTile(TileKey key, int changes_near) {
  const DistanceTile* tile = tiles_.tree().Find(key);
  if (tile == nullptr) return MakeTile(key, changes_near);
  BlockMask any = FindSitesNear(key, changes_near, *tile);
  DistanceTile* edited = nullptr;
  BlockMask lost = 0;
  for (; any != 0; any &= any - 1) {
    const int block = std::countr_zero(any);
    const VertexBlock vertices = BlockOf(block);
    const int index = IndexInTile(vertices.x0, vertices.y0);
    NearestSites nearest(NearestSites::Of::kAllVertices, &tile->nearest[index], Square(reach_));
    // What came first: a vertex for which it is nearer than what went does not have to look around.
    const bool is_nearer = !came_near_[block].empty() && nearest.Add(came_near_[block], vertices);
    const bool is_lost =
        !went_near_[block].empty() && nearest.TakeAway(went_near_[block], vertices);
    if (!is_nearer && !is_lost) continue;
    if (edited == nullptr) tile = edited = &tiles_.Edit(key, 0);
    PutOffsets(nearest.Offsets(), &edited->nearest[index]);
    edited->longest[block] = nearest.LongestSquared();
    if (is_lost) lost |= any & -any;
  }
  if (lost == 0) return;
  FillBlocks(key, lost, *edited);
  if (*edited == *nothing_near_) tiles_.Put(key, nothing_near_, 0);
}

// That was absent.
void DistanceFieldEditor::MakeTile(TileKey key, int changes_near) {
  BlockMask blocks = 0;
  if (options_.unknown == UnknownPolicy::kBlocked) {
    if (!obstacles_.contains(key)) return;
    blocks = ~blocks;
  } else {
    for (int at = changes_near; at != ChangesNear::kNoMore; at = changes_near_[at].next) {
      for (int k = changes_near_[at].begin; k < changes_near_[at].end; ++k) {
        if (changes_[k].came) blocks |= BlocksNear(changes_[k], key, *nothing_near_);
      }
    }
    if (blocks == 0) return;
  }
  DistanceTile tile = *nothing_near_;
  BlockOffsets all_lost;
  all_lost.fill(kLost);
  for (BlockMask rest = blocks; rest != 0; rest &= rest - 1) {
    const VertexBlock vertices = BlockOf(std::countr_zero(rest));
    PutOffsets(all_lost, &tile.nearest[IndexInTile(vertices.x0, vertices.y0)]);
  }
  FillBlocks(key, blocks, tile);
  if (tile != *nothing_near_) {
    tiles_.Edit(key, 0) = tile;
  } else if (options_.unknown == UnknownPolicy::kBlocked) {
    tiles_.Put(key, nothing_near_, 0);
  }
}

// By block of a tile, the changed sites that may be nearest to one of its vertices. Says which
// blocks have any.
DistanceFieldEditor::BlockMask DistanceFieldEditor::FindSitesNear(TileKey key, int changes_near,
                                                                  const DistanceTile& tile) {
  BlockMask any = 0;
  for (int at = changes_near; at != ChangesNear::kNoMore; at = changes_near_[at].next) {
    for (int k = changes_near_[at].begin; k < changes_near_[at].end; ++k) {
      const Change& change = changes_[k];
      const auto sites =
          absl::MakeConstSpan(changed_).subspan(change.begin, change.end - change.begin);
      const int dx = change.tile.tx - key.tx;
      const int dy = change.tile.ty - key.ty;
      for (BlockMask near = BlocksNear(change, key, tile); near != 0; near &= near - 1) {
        const int block = std::countr_zero(near);
        const BlockMask bit = near & -near;
        const VertexBlock vertices = BlockOf(block);
        const VertexBlock from_change{vertices.x0 - Tile::kSide * dx,
                                      vertices.y0 - Tile::kSide * dy};
        // Most sites are hidden from all of the block by what is near one of its vertices.
        absl::Span<const Site> seen = sites;
        const Offset& offset =
            tile.nearest[IndexInTile(vertices.x0, vertices.y0) + IndexInTile(4, 4)];
        if (offset.x != Offset::kNone) {
          const Site vertex =
              VertexAt(from_change, VertexBlock::kSize / 2 + VertexBlock::kSide / 2);
          seen = some_sites_.NotHidden(
              sites, {VertexAt(from_change, 0), VertexAt(from_change, VertexBlock::kSize - 1)},
              SiteAt(vertex.x + offset.x, vertex.y + offset.y));
          if (seen.empty()) continue;
        }
        if ((any & bit) == 0) {
          any |= bit;
          came_near_[block].clear();
          went_near_[block].clear();
        }
        std::vector<Site>& sites_near = change.came ? came_near_[block] : went_near_[block];
        for (const Site& site : seen) {
          sites_near.push_back(SiteAt(site.x + kTileUnits * dx, site.y + kTileUnits * dy));
        }
      }
    }
  }
  return any;
}

// Those with a vertex that may be no farther from a square of the change than from what it has.
DistanceFieldEditor::BlockMask DistanceFieldEditor::BlocksNear(const Change& change, TileKey key,
                                                               const DistanceTile& tile) {
  const int x = kTileUnits * (change.tile.tx - key.tx);
  const int y = kTileUnits * (change.tile.ty - key.ty);
  return static_cast<BlockMask>(FastestDistanceKernel().blocks_near(
      {SiteAt(change.low.x + x, change.low.y + y), SiteAt(change.high.x + x, change.high.y + y)}, 0,
      kBlockUnits - kUnits, tile.longest.data()));
}

void DistanceFieldEditor::FillBlocks(TileKey key, BlockMask blocks, DistanceTile& tile) {
  FindObstaclesAround(key);
  const TileNeighborhood surroundings(*this, key);
  for (; blocks != 0; blocks &= blocks - 1) {
    FillBlock(BlockOf(std::countr_zero(blocks)), surroundings, tile);
  }
}

// Finds what is nearest to the vertices that lost what they had.
void DistanceFieldEditor::FillBlock(const VertexBlock& block, const TileNeighborhood& surroundings,
                                    DistanceTile& tile) {
  Offset* offsets = &tile.nearest[IndexInTile(block.x0, block.y0)];
  const int bx = block.x0 / VertexBlock::kSide;
  NearestSites nearest(NearestSites::Of::kLostOnes, offsets, Square(reach_));
  const uint64_t lost = nearest.LostOnes();
  sites_.clear();
  AddSitesAtCorners(block, lost, surroundings);
  AddSitesOfNeighbors(block, lost, tile);
  nearest.Add(sites_, block);
  AddSitesAround(block, lost, nearest);
  PutOffsets(nearest.Offsets(), offsets);
  tile.longest[kBlocks * (block.y0 / VertexBlock::kSide) + bx] =
      NearestSites(NearestSites::Of::kAllVertices, offsets, Square(reach_)).LongestSquared();
}

// The squares that have a vertex as their corner: not all of them have to be at the boundary.
void DistanceFieldEditor::AddSitesAtCorners(const VertexBlock& block, uint64_t lost,
                                            const TileNeighborhood& surroundings) {
  constexpr uint64_t kFirstOfKnot = 0x11111111;
  constexpr int kPerKnot = ObstacleSquares::kPerKnot;
  const int x0 = kPerKnot * block.x0;
  const int y0 = kPerKnot * block.y0;
  const auto add = [&](int row, uint64_t squares) {
    uint64_t with_corner = (squares | squares >> 1) & kFirstOfKnot;
    if (with_corner == 0 || (row + 1) % kPerKnot > 1) return;
    const uint64_t lost_of_row = lost >> (VertexBlock::kSide * ((row + 1 - y0) / kPerKnot));
    for (; with_corner != 0; with_corner &= with_corner - 1) {
      const int x = std::countr_zero(with_corner);
      if ((lost_of_row >> x / kPerKnot & 1) == 0) continue;
      if ((squares >> x & 1) != 0) sites_.push_back(CentreOf(x0 + x - 1, row));
      if ((squares >> x & 2) != 0) sites_.push_back(CentreOf(x0 + x, row));
    }
  };
  surroundings.ForEachRow(block.x0 / VertexBlock::kSide, y0 - 1, y0 + kSquaresOfBlock - 1, add);
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

// What some vertices beside those that lost theirs have is near these, too: it bounds what else may
// be.
void DistanceFieldEditor::AddSitesOfNeighbors(const VertexBlock& block, uint64_t lost,
                                              const DistanceTile& tile) {
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
  for (const Side& side : sides) {
    const uint64_t all = lost & ~side.lost_there;
    // The first and the last of them: more would take longer than what they save.
    for (uint64_t rest = (all & -all) | std::bit_floor(all); rest != 0; rest &= rest - 1) {
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
}

// All that can be nearest to a vertex that lost what it had: ring by ring of the tiles around it,
// until what is there is farther from all of them than the nearest so far.
void DistanceFieldEditor::AddSitesAround(const VertexBlock& block, uint64_t lost,
                                         NearestSites& nearest) {
  uint64_t columns = lost | lost >> 32;
  columns |= columns >> 16;
  columns = (columns | columns >> 8) & 0xFF;
  const int first_row = std::countr_zero(lost) / VertexBlock::kSide;
  const int last_row = (63 - std::countl_zero(lost)) / VertexBlock::kSide;
  const VertexBox box{
      VertexAt(block, VertexBlock::kSide * first_row + std::countr_zero(columns)),
      VertexAt(block, VertexBlock::kSide * last_row + 63 - std::countl_zero(columns))};
  // One of them, in the middle.
  uint64_t upper = lost;
  for (int n = std::popcount(lost) / 2; n > 0; --n) upper &= upper - 1;
  const int middle = std::countr_zero(upper);
  const int last = std::max({-around_.tx0, around_.tx1 - 1, -around_.ty0, around_.ty1 - 1});
  int32_t end_squared = nearest.LongestSquared();
  const int to_rim =
      std::min<int>({box.low.x, box.low.y, kTileUnits - box.high.x, kTileUnits - box.high.y});
  for (int ring = 0; ring <= last; ++ring) {
    if (ring > 0 && Square(to_rim + kTileUnits * (ring - 1)) > end_squared) return;
    for (int ty = std::max(-ring, around_.ty0); ty < std::min(ring + 1, around_.ty1); ++ty) {
      const int32_t squared_y =
          Square(Gap(kTileUnits * ty, kTileUnits * (ty + 1), box.low.y, box.high.y));
      if (squared_y > end_squared) continue;
      const int step = std::abs(ty) == ring ? 1 : 2 * ring;
      for (int tx = -ring; tx <= ring; tx += step) {
        const int32_t squared_x =
            Square(Gap(kTileUnits * tx, kTileUnits * (tx + 1), box.low.x, box.high.x));
        if (squared_x + squared_y > end_squared || tx < around_.tx0 || tx >= around_.tx1) continue;
        const Obstacles* obstacles =
            obstacles_around_[(ty - around_.ty0) * (around_.tx1 - around_.tx0) + tx - around_.tx0];
        if (obstacles == nullptr) continue;
        AddSitesOfTile(block, {tx, ty}, *obstacles, box, middle, nearest, end_squared);
      }
    }
  }
}

// Those at the boundary of the obstacles of a tile, counted from that of the block.
void DistanceFieldEditor::AddSitesOfTile(const VertexBlock& block, TileKey from,
                                         const Obstacles& obstacles, const VertexBox& of_lost,
                                         int middle, NearestSites& nearest, int32_t& end_squared) {
  const int x = kTileUnits * from.tx;
  const int y = kTileUnits * from.ty;
  const VertexBox box{SiteAt(of_lost.low.x - x, of_lost.low.y - y),
                      SiteAt(of_lost.high.x - x, of_lost.high.y - y)};
  const VertexBlock from_there{block.x0 - Tile::kSide * from.tx, block.y0 - Tile::kSide * from.ty};
  alignas(32) std::array<int32_t, kBlocks * kBlocks> limits;
  limits.fill(end_squared);
  uint32_t blocks = FastestDistanceKernel().blocks_near(box, 1, kBlockUnits - 1, limits.data()) &
                    obstacles.with_boundary;
  for (; blocks != 0; blocks &= blocks - 1) {
    const int k = std::countr_zero(blocks);
    const int begin = obstacles.ends[k];
    const absl::Span<const Site> sites(&obstacles.boundary[begin],
                                       static_cast<size_t>(obstacles.ends[k + 1] - begin));
    Site other = sites[sites.size() / 2];
    const Offset offset = nearest.OffsetOf(middle);
    if (offset.x != Offset::kNone) {
      const Site vertex = VertexAt(from_there, middle);
      other = SiteAt(vertex.x + offset.x, vertex.y + offset.y);
    }
    if (nearest.Add(some_sites_.NotHidden(sites, box, other), from_there)) {
      end_squared = nearest.LongestSquared();
    }
  }
}

}  // namespace splinemap
