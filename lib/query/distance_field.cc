#include "lib/query/distance_field.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <numbers>

#include "lib/map/key_tree_impl.h"
#include "lib/query/footprint.h"
#include "lib/query/obstacle_search.h"

namespace splinemap {

template class KeyTree<DistanceTile>;
template class KeyTreeEditor<DistanceTile>;

namespace {

constexpr int kUnits = 8;  // to a knot interval
constexpr int kTileUnits = Tile::kSide * kUnits;
constexpr double kMaxDoubt = 0.625 * kUnits;

using Row = ObstacleSquares::Row;

// The block's vertices.
VertexBox VerticesOf(int block) {
  constexpr int kBlockSide = DistanceTile::kBlockSide;
  const auto end = [](int begin) {
    return begin + kBlockSide == Tile::kSide ? Tile::kSide : begin + kBlockSide - 1;
  };
  const int x0 = kBlockSide * (block % DistanceTile::kBlocks);
  const int y0 = kBlockSide * (block / DistanceTile::kBlocks);
  return {x0, y0, end(x0), end(y0)};
}

}  // namespace

DistancesQuery::Distance DistanceField::At(const Eigen::Vector2d& point_m) const {
  const DistancesQuery::Distance far{options_.max_distance_m, Eigen::Vector2d::Zero()};
  const DistancesQuery::Distance unknown =
      options_.unknown == Unknown::kStops ? DistancesQuery::Distance() : far;
  const double knot_interval_m = map_->options.knot_interval_m;
  const auto x = LocateKnot(point_m.x(), knot_interval_m);
  const auto y = LocateKnot(point_m.y(), knot_interval_m);
  if (!x || !y) return unknown;
  const DistanceTile* tile = tiles_.Find(TileOf(x->index, y->index));
  if (tile == nullptr) return unknown;
  const int corner =
      DistanceTile::kSide * (y->index & (Tile::kSide - 1)) + (x->index & (Tile::kSide - 1));
  // Squares of distances in eighths: of the nearest, and the least that it can be.
  double most = std::numeric_limits<double>::infinity();
  double least = -kUnits * kUnits * (x->t * (1 - x->t) + y->t * (1 - y->t));
  Eigen::Vector2d away = Eigen::Vector2d::Zero();
  for (int k = 0; k < 4; ++k) {
    const int right = k % 2;
    const int up = k / 2;
    const DistanceTile::Offset offset = tile->nearest[corner + right + DistanceTile::kSide * up];
    if (offset.x == DistanceTile::Offset::kNone) return far;
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

DistancesQuery::Distance DistanceField::Search(const Eigen::Vector2d& point_m) const {
  ObstacleSearch search(*map_, bounds_, options_.occupied_log_odds, options_.unknown);
  return FindDistance(search, point_m, options_.max_distance_m, map_->options.knot_interval_m);
}

DistanceField DistanceFieldEditor::Update(std::shared_ptr<const MapSnapshot> map) {
  const uint64_t line = bounds_of_map_.tiles.line();
  const uint64_t epoch = bounds_of_map_.tiles.epoch();
  bounds_of_map_ = bounds_.Update(*map);
  const bool goes_on =
      bounds_of_map_.tiles.line() == line && map->options.knot_interval_m == knot_interval_m_;
  if (!goes_on) BeginAnew(*map);
  std::vector<TileKey> touched;
  bounds_of_map_.tiles.ForEachChanged(
      goes_on ? epoch : 0,
      [&](TileKey key, const KeyTree<TileBounds>::Entry&) { touched.push_back(key); });

  absl::flat_hash_map<TileKey, Blocks> marked;
  if (options_.unknown == Unknown::kStops) {
    for (const TileKey key : touched) {
      if (tiles_.tree().Find(key) == nullptr) marked[key] = ~Blocks{0};
    }
  }
  for (const Change& change : UpdateObstacles(*map, touched)) {
    MarkBlocksNear(change, marked);
  }
  for (const auto& [key, blocks] : marked) UpdateTile(key, blocks);

  DistanceField field;
  field.options_ = options_;
  field.options_.max_distance_m =
      std::min(options_.max_distance_m, DistanceFieldOptions::kMaxReach * knot_interval_m_);
  field.map_ = std::move(map);
  field.bounds_ = bounds_of_map_;
  field.tiles_ = tiles_.Freeze();
  return field;
}

void DistanceFieldEditor::BeginAnew(const MapSnapshot& map) {
  obstacles_.clear();
  obstacles_box_ = {};
  tiles_ = KeyTreeEditor<DistanceTile>();
  knot_interval_m_ = map.options.knot_interval_m;
  const double reach =
      std::min(options_.max_distance_m / knot_interval_m_, DistanceFieldOptions::kMaxReach);
  // From a point that is nearer than that, the vertices around it are not farther than a diagonal.
  reach_ = static_cast<int32_t>(std::ceil(kUnits * (reach + std::numbers::sqrt2)));
  reach_tiles_ = reach_ / kTileUnits + 1;
  DistanceTile nothing_near;
  nothing_near.longest.fill(reach_ * reach_);
  nothing_near_ = std::make_shared<const DistanceTile>(nothing_near);
}

const ObstacleSquares& DistanceFieldEditor::SquaresAt(TileKey key) const {
  static const ObstacleSquares none;
  static const ObstacleSquares all = ObstacleSquares::All();
  const auto found = obstacles_.find(key);
  if (found != obstacles_.end()) return found->second->squares;
  return options_.unknown == Unknown::kStops ? all : none;
}

std::vector<DistanceFieldEditor::Change> DistanceFieldEditor::UpdateObstacles(
    const MapSnapshot& map, absl::Span<const TileKey> touched) {
  std::vector<Change> changes;
  absl::flat_hash_set<TileKey> changed;
  PatchReader patches(map.merged);
  for (const TileKey key : touched) {
    const ObstacleSquares squares =
        SquaresOf(patches, key, *bounds_of_map_.tiles.Find(key),
                  options_.occupied_log_odds * kUnitsPerLogOdds, options_.unknown);
    const size_t num_changes = changes.size();
    AddChanges(key, SquaresAt(key), squares, changes);
    if (changes.size() > num_changes) changed.insert(key);
    if (options_.unknown == Unknown::kPasses && squares.IsEmpty()) {
      obstacles_.erase(key);
      continue;
    }
    std::unique_ptr<Obstacles>& obstacles = obstacles_[key];
    if (obstacles == nullptr) obstacles = std::make_unique<Obstacles>();
    obstacles->squares = squares;
    obstacles_box_.Add(key);
  }
  UpdateRims(changed);
  return changes;
}

// Boxes around what differs, of each block of 8 x 8 knot cells one.
void DistanceFieldEditor::AddChanges(TileKey key, const ObstacleSquares& before,
                                     const ObstacleSquares& after, std::vector<Change>& changes) {
  constexpr int kBlockSide = ObstacleSquares::kSide / DistanceTile::kBlocks;
  for (int by = 0; by < DistanceTile::kBlocks; ++by) {
    Row changed = 0;
    for (int y = kBlockSide * by; y < kBlockSide * (by + 1); ++y) {
      changed |= before.rows[y] ^ after.rows[y];
    }
    if (changed == 0) continue;
    for (int bx = 0; bx < DistanceTile::kBlocks; ++bx) {
      const auto columns = static_cast<uint32_t>(changed >> (kBlockSide * bx));
      if (columns == 0) continue;
      int first = ObstacleSquares::kSide;
      int last = 0;
      for (int y = kBlockSide * by; y < kBlockSide * (by + 1); ++y) {
        const Row row = (before.rows[y] ^ after.rows[y]) >> (kBlockSide * bx);
        if (static_cast<uint32_t>(row) == 0) continue;
        first = std::min(first, y);
        last = y;
      }
      // What is at the rim depends on the squares beside it.
      const int left = kBlockSide * bx + std::countr_zero(columns) - 1;
      const int right = kBlockSide * bx + std::bit_width(columns);
      changes.push_back({key, {2 * left + 1, 2 * first - 1, 2 * right + 1, 2 * last + 3}});
    }
  }
}

// The squares of a tile and those next to it.
class DistanceFieldEditor::Surroundings {
 public:
  Surroundings(const DistanceFieldEditor& editor, TileKey key) {
    for (int k = 0; k < 9; ++k) {
      tiles_[k] = &editor.SquaresAt({key.tx + k % 3 - 1, key.ty + k / 3 - 1});
    }
  }

  // Row y in [-1, 128], and the squares on its left and its right.
  struct WideRow {
    Row row;
    Row left;   // 0 or 1
    Row right;  // 0 or 1
    Row shifted_right() const { return row << 1 | left; }
    Row shifted_left() const { return row >> 1 | right << (kSide - 1); }
  };
  WideRow At(int y) const {
    const int ty = y < 0 ? 0 : y < kSide ? 1 : 2;
    const int row = y & (kSide - 1);
    return {tiles_[3 * ty + 1]->rows[row], tiles_[3 * ty]->rows[row] >> (kSide - 1),
            tiles_[3 * ty + 2]->rows[row] & 1};
  }

  // Whether the four squares around a vertex are there.
  bool AreAllAround(int x, int y) const {
    const WideRow below = At(ObstacleSquares::kPerKnot * y - 1);
    const WideRow above = At(ObstacleSquares::kPerKnot * y);
    if (x == Tile::kSide) {
      return (below.row & above.row) >> (kSide - 1) != 0 && (below.right & above.right) != 0;
    }
    const Row all = below.row & above.row & below.shifted_right() & above.shifted_right();
    return (all >> (ObstacleSquares::kPerKnot * x) & 1) != 0;
  }

 private:
  static constexpr int kSide = ObstacleSquares::kSide;
  std::array<const ObstacleSquares*, 9> tiles_;
};

void DistanceFieldEditor::UpdateRims(const absl::flat_hash_set<TileKey>& changed) {
  absl::flat_hash_set<TileKey> beside = changed;
  for (const TileKey key : changed) {
    beside.insert(
        {{key.tx - 1, key.ty}, {key.tx + 1, key.ty}, {key.tx, key.ty - 1}, {key.tx, key.ty + 1}});
  }
  for (const TileKey key : beside) {
    const auto found = obstacles_.find(key);
    if (found == obstacles_.end()) continue;
    std::vector<Site>& rim = found->second->rim;
    rim.clear();
    const Surroundings surroundings(*this, key);
    for (int y = 0; y < ObstacleSquares::kSide; ++y) {
      const Surroundings::WideRow row = surroundings.At(y);
      Row rest = row.row & ~(row.shifted_left() & row.shifted_right() & surroundings.At(y - 1).row &
                             surroundings.At(y + 1).row);
      while (rest != 0) {
        const auto low = static_cast<uint64_t>(rest);
        const int x = low != 0 ? std::countr_zero(low)
                               : 64 + std::countr_zero(static_cast<uint64_t>(rest >> 64));
        rim.push_back({2 * x + 1, 2 * y + 1});
        rest &= rest - 1;
      }
    }
  }
}

// Those that may have something of the change as their nearest, before or after it: that is not
// nearer than what they have.
void DistanceFieldEditor::MarkBlocksNear(const Change& change,
                                         absl::flat_hash_map<TileKey, Blocks>& marked) const {
  const auto distance = [](int32_t a0, int32_t a1, int32_t b0, int32_t b1) {
    return std::max({a0 - b1, b0 - a1, 0});
  };
  for (int dy = -reach_tiles_; dy <= reach_tiles_; ++dy) {
    for (int dx = -reach_tiles_; dx <= reach_tiles_; ++dx) {
      const TileKey key{change.tile.tx + dx, change.tile.ty + dy};
      if (!IsInRange(key)) continue;
      if (options_.unknown == Unknown::kStops && !obstacles_.contains(key)) continue;
      const Box box{change.box.x0 - kTileUnits * dx, change.box.y0 - kTileUnits * dy,
                    change.box.x1 - kTileUnits * dx, change.box.y1 - kTileUnits * dy};
      const int32_t x = distance(0, kTileUnits, box.x0, box.x1);
      const int32_t y = distance(0, kTileUnits, box.y0, box.y1);
      if (x * x + y * y > reach_ * reach_) continue;
      const DistanceTile* tile = tiles_.tree().Find(key);
      Blocks blocks = 0;
      for (int block = 0; block < DistanceTile::kBlocks * DistanceTile::kBlocks; ++block) {
        const VertexBox vertices = VerticesOf(block);
        const int32_t longest = tile == nullptr ? reach_ * reach_ : tile->longest[block];
        const int32_t bx = distance(kUnits * vertices.x0, kUnits * vertices.x1, box.x0, box.x1);
        const int32_t by = distance(kUnits * vertices.y0, kUnits * vertices.y1, box.y0, box.y1);
        if (bx * bx + by * by <= longest) blocks |= static_cast<Blocks>(1 << block);
      }
      if (blocks != 0) marked[key] |= blocks;
    }
  }
}

void DistanceFieldEditor::GatherSitesAround(TileKey key) {
  sites_.clear();
  const TileBox& box = obstacles_box_;
  for (int ty = std::max(key.ty - reach_tiles_, box.ty0);
       ty < std::min(key.ty + reach_tiles_ + 1, box.ty1); ++ty) {
    for (int tx = std::max(key.tx - reach_tiles_, box.tx0);
         tx < std::min(key.tx + reach_tiles_ + 1, box.tx1); ++tx) {
      const auto found = obstacles_.find({tx, ty});
      if (found == obstacles_.end()) continue;
      const int32_t x = kTileUnits * (tx - key.tx);
      const int32_t y = kTileUnits * (ty - key.ty);
      for (const Site& site : found->second->rim) sites_.push_back({site.x + x, site.y + y});
    }
  }
}

void DistanceFieldEditor::UpdateTile(TileKey key, Blocks blocks) {
  const DistanceTile* before = tiles_.tree().Find(key);
  DistanceTile tile = before == nullptr ? *nothing_near_ : *before;
  GatherSitesAround(key);
  NearestSites::LeaveOut(sites_, {0, 0, Tile::kSide, Tile::kSide});
  const Surroundings surroundings(*this, key);
  for (int block = 0; block < DistanceTile::kBlocks * DistanceTile::kBlocks; ++block) {
    if ((blocks >> block & 1) != 0) UpdateBlock(block, surroundings, tile);
  }
  if (tile != *nothing_near_) {
    tiles_.Edit(key, 0) = tile;
  } else if (before != nullptr || options_.unknown == Unknown::kStops) {
    tiles_.Put(key, nothing_near_, 0);
  }
}

void DistanceFieldEditor::UpdateBlock(int block, const Surroundings& surroundings,
                                      DistanceTile& tile) {
  const VertexBox vertices = VerticesOf(block);
  int32_t longest = 0;
  const auto set = [&](int x, int y, DistanceTile::Offset offset) {
    const int32_t squared = offset.x * offset.x + offset.y * offset.y;
    const bool is_near = squared <= reach_ * reach_;
    longest = std::max(longest, is_near ? squared : reach_ * reach_);
    tile.nearest[DistanceTile::kSide * y + x] = is_near ? offset : DistanceTile::Offset();
  };
  for (int y = vertices.y0; y <= vertices.y1; ++y) {
    for (int x = vertices.x0; x <= vertices.x1; ++x) {
      tile.nearest[DistanceTile::kSide * y + x] = DistanceTile::Offset();
    }
  }
  if (sites_.empty()) longest = reach_ * reach_;
  nearest_.Find(sites_, vertices, [&](int x, int y, const Site& site) {
    set(x, y,
        {static_cast<int16_t>(site.x - kUnits * x), static_cast<int16_t>(site.y - kUnits * y)});
  });
  // Between four squares, none of which has to be at the rim.
  for (int y = vertices.y0; y <= vertices.y1; ++y) {
    for (int x = vertices.x0; x <= vertices.x1; ++x) {
      if (surroundings.AreAllAround(x, y)) set(x, y, {-1, -1});
    }
  }
  tile.longest[block] = longest;
}

}  // namespace splinemap
