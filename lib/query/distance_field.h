#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <memory>
#include <vector>

#include "absl/container/flat_hash_map.h"
#include "absl/container/flat_hash_set.h"
#include "lib/map/key_tree.h"
#include "lib/map/map.h"
#include "lib/map/region.h"
#include "lib/query/nearest_sites.h"
#include "lib/query/obstacle_squares.h"
#include "lib/query/queries.h"
#include "lib/query/surface_bounds.h"

namespace splinemap {

struct DistanceFieldOptions {
  // Up to kMaxReach knot intervals; beyond that it is as that. An update costs up to its square.
  double max_distance_m = 2;
  double occupied_log_odds = kEvenLogOdds;
  Unknown unknown = Unknown::kPasses;  // kStops: what is not known is an obstacle

  static constexpr double kMaxReach = 2000;
};

// Of the vertices of the knot grid in a tile, those on all of its sides included: where the nearest
// obstacle is.
struct DistanceTile {
  static constexpr int kSide = Tile::kSide + 1;
  static constexpr int kBlocks = 4;     // each way
  static constexpr int kBlockSide = 8;  // the last has the vertices of the far side, too

  // To the centre of a square of 1/4 knot interval, in eighths.
  struct Offset {
    static constexpr int16_t kNone = INT16_MIN;  // nothing is near

    int16_t x = kNone;
    int16_t y = kNone;
    bool operator==(const Offset&) const = default;
  };
  std::array<Offset, kSide * kSide> nearest;  // x runs fastest
  // The longest of a block, squared; the greatest reach where nothing is near.
  std::array<int32_t, kBlocks * kBlocks> longest;

  bool operator==(const DistanceTile&) const = default;
};

// How far the nearest obstacle is from any point, for those who ask often: some 50 ns, where a
// DistancesQuery searches for some 10 us. Made by a DistanceFieldEditor. Immutable, thread-safe.
class DistanceField {
 public:
  // In knot intervals: a distance differs by no more than this from what the search says, that is
  // from DistancesQuery::Distance, and where unknown stops from a search that stops there.
  //
  // Why: the obstacles are the squares of ObstacleSquares, and the search finds a part of one,
  // which is no farther than half of a diagonal, sqrt(2) / 8, from its centre. Of the centres the
  // nearest to the point is at most as far as the nearest of those that are nearest to the four
  // vertices around it, and at least so far that its square is the mean of their squares less the
  // mean square of their own distances, by the weights of bilinear interpolation: squares of
  // distances less |p|^2 are concave. What is said is the middle between these; the two are no more
  // than 5/8 apart, or the search itself answers.
  static constexpr double kErrorBound = 0.5;

  // Distance in metres and its gradient: the direction from the nearest obstacle that is known of,
  // of length 1; 0 where nothing is near and where the search says so. Of points that are not
  // finite or off the map (kMaxKnotIndex): as of any that is not known.
  DistancesQuery::Distance At(const Eigen::Vector2d& point_m) const;

  const KeyTree<DistanceTile>& tiles() const { return tiles_; }

 private:
  friend class DistanceFieldEditor;

  DistancesQuery::Distance Search(const Eigen::Vector2d& point_m) const;

  DistanceFieldOptions options_;
  std::shared_ptr<const MapSnapshot> map_ = std::make_shared<const MapSnapshot>();
  SurfaceBounds bounds_;
  // Absent: nothing is near, or where unknown stops, nothing is known.
  KeyTree<DistanceTile> tiles_;
};

// Follows a map. Thread-compatible.
class DistanceFieldEditor {
 public:
  explicit DistanceFieldEditor(DistanceFieldOptions options) : options_(options) {}

  // The field of this map, the same to the last byte whatever was seen before. Costs what changed
  // since the last call, where that was an earlier snapshot of the same Map: a look at the tiles
  // that changed, and where squares did, blocks of 8 x 8 vertices that are not nearer to others.
  DistanceField Update(std::shared_ptr<const MapSnapshot> map);

 private:
  // In eighths of a knot interval from the corner of a tile: [x0, x1] x [y0, y1].
  struct Box {
    int32_t x0;
    int32_t y0;
    int32_t x1;
    int32_t y1;
  };
  struct Change {
    TileKey tile;
    Box box;  // of the centres of squares
  };
  struct Obstacles {
    ObstacleSquares squares;
    // Centres of those squares that do not lie between four others.
    std::vector<Site> rim;
  };
  class Surroundings;
  using Blocks = uint16_t;  // a bit for each of a tile

  void BeginAnew(const MapSnapshot& map);
  std::vector<Change> UpdateObstacles(const MapSnapshot& map, absl::Span<const TileKey> touched);
  static void AddChanges(TileKey key, const ObstacleSquares& before, const ObstacleSquares& after,
                         std::vector<Change>& changes);
  void UpdateRims(const absl::flat_hash_set<TileKey>& changed);
  void MarkBlocksNear(const Change& change, absl::flat_hash_map<TileKey, Blocks>& marked) const;
  void UpdateTile(TileKey key, Blocks blocks);
  void UpdateBlock(int block, const Surroundings& surroundings, DistanceTile& tile);
  void GatherSitesAround(TileKey key);
  const ObstacleSquares& SquaresAt(TileKey key) const;

  const DistanceFieldOptions options_;
  SurfaceBoundsEditor bounds_;
  SurfaceBounds bounds_of_map_;
  double knot_interval_m_ = 0;
  // To what vertices may be from what counts, in eighths of a knot interval; and in tiles.
  int32_t reach_ = 0;
  int32_t reach_tiles_ = 0;
  // Absent: no square, or where unknown stops, all of them.
  absl::flat_hash_map<TileKey, std::unique_ptr<Obstacles>> obstacles_;
  TileBox obstacles_box_;
  KeyTreeEditor<DistanceTile> tiles_;
  std::shared_ptr<const DistanceTile> nothing_near_;
  // Of the tile that is being updated.
  std::vector<Site> sites_;
  NearestSites nearest_;
};

}  // namespace splinemap
