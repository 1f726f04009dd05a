#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <memory>
#include <vector>

#include "absl/container/flat_hash_map.h"
#include "absl/types/span.h"
#include "lib/distance/nearest_sites.h"
#include "lib/distance/obstacle_squares.h"
#include "lib/query/surface_bounds.h"
#include "splinemap/key_tree.h"
#include "splinemap/map_view.h"
#include "splinemap/queries.h"
#include "splinemap/region.h"

namespace splinemap {

struct DistanceFieldOptions {
  // 0 to kMaxReach knot intervals; more is as that. Where nothing is near, updates and tiles go as
  // its square.
  double max_distance_m = 2;
  double occupied_log_odds = kDefaultOccupied;   // finite
  UnknownPolicy unknown = UnknownPolicy::kFree;  // kBlocked: what is not known is an obstacle

  static constexpr double kMaxReach = 2000;
};

// Of each vertex (i, j) of the knot grid, in tile TileOf(i, j) at IndexInTile(i, j): where the
// nearest obstacle is: of the squares of ObstacleSquares the nearest; of those that are equally
// near that of the least y, of these that of the least x.
struct DistanceTile {
  static constexpr int kBlocks = Tile::kSide / VertexBlock::kSide;  // each way

  using Offset = SiteOffset;
  std::array<Offset, Tile::kSize> nearest;
  // The longest of a block, squared; the greatest reach where nothing is near.
  std::array<int32_t, kBlocks * kBlocks> longest;

  bool operator==(const DistanceTile&) const = default;
};

// How far the nearest obstacle is from any point of the map frame, for those who ask often: some
// 100 ns, where a DistancesQuery searches for some 10 us. Who must not touch anything asks for a
// sweep, or takes the error off. Made by a DistanceFieldEditor. Immutable, thread-safe.
class DistanceField {
 public:
  // In knot intervals: a distance differs by no more than this from what the search says, which is
  // a DistancesQuery::Distance, and where unknown stops that to what is occupied or unknown.
  //
  // Why: the obstacles are the squares of ObstacleSquares. The search finds a part of one, which is
  // sqrt(2) / 8 at most from its centre, so it says the distance of the nearest centre to that. Of
  // centres that are nearest to the four vertices around the point, the nearest to the point is at
  // least as far. And the squared distance of the nearest centre less |p|^2 is concave in p, as the
  // least of linear functions; so it is at least its bilinear interpolation from the vertices. What
  // is said is the middle between these two; they are no more than 5/8 apart, or the search itself
  // answers: 5/16 + sqrt(2) / 8 < 1/2.
  static constexpr double kErrorBound = 0.5;

  // Distance in metres, at most max_distance_m, and its gradient: of length 1, away from an
  // obstacle that is within kErrorBound of where it points back to; 0 where nothing is near, and
  // where the search says so. Of points that are not finite or off the map (kMaxKnotIndex) the same
  // as of others that are not known and have nothing near.
  DistancesQuery::Distance At(const Eigen::Vector2d& point_m) const;

  const KeyTree<DistanceTile>& tiles() const { return tiles_; }

 private:
  friend class DistanceFieldEditor;

  DistancesQuery::Distance Search(const Eigen::Vector2d& point_m) const;
  DistanceTile::Offset OffsetAt(TileKey home, const DistanceTile& tile, int32_t i, int32_t j) const;

  DistanceFieldOptions options_;
  std::shared_ptr<const MapView> map_ = std::make_shared<const MapView>();
  SurfaceBounds bounds_;
  // Absent: nothing is near, or where unknown stops, nothing is known.
  KeyTree<DistanceTile> tiles_;
};

// Follows a map. Thread-compatible.
class DistanceFieldEditor {
 public:
  explicit DistanceFieldEditor(DistanceFieldOptions options) : options_(options) {}

  // The field of this map, the same to the last byte whatever was seen before. Costs what changed
  // since the last call, where that was about an earlier view by the same SummedLayers: cells whose
  // control points changed are looked at; squares that came are taken where they are nearer; and
  // vertices whose square went look for what is nearest now.
  DistanceField Update(std::shared_ptr<const MapView> map);

 private:
  // Of what is of the blocks of 8 x 8 in a tile.
  static constexpr int kBlocks = DistanceTile::kBlocks;
  using BlockMask = uint16_t;

  struct Obstacles {
    ObstacleSquares squares;
    // The centres of those squares that do not lie between four others, by block: block k has
    // those from ends[k] on to ends[k + 1].
    std::vector<Site> boundary;
    std::array<int, kBlocks * kBlocks + 1> ends{};
    BlockMask with_boundary = 0;  // blocks that have any
  };
  // The centres of squares of a block that came, or went, in changed_, and the box around them.
  struct Change {
    TileKey tile;
    int block = 0;
    bool came = false;
    int begin = 0;
    int end = 0;
    Site low{};
    Site high{};
  };
  // Changes of one tile that may be near another, and where there are more for that other.
  struct ChangesNear {
    static constexpr int kNoMore = -1;

    int begin;
    int end;
    int next;
  };
  class TileNeighborhood;

  void BeginAnew(const MapView& map);
  void UpdateObstacles(const MapView& map);
  void AddChanges(TileKey key, const ObstacleSquares& before, const ObstacleSquares& after);
  void UpdateRims();
  void FindTilesNear();
  void UpdateTile(TileKey key, int changes_near);
  void MakeTile(TileKey key, int changes_near);
  BlockMask FindSitesNear(TileKey key, int changes_near, const DistanceTile& tile);
  static BlockMask BlocksNear(const Change& change, TileKey key, const DistanceTile& tile);
  void FillBlocks(TileKey key, BlockMask blocks, DistanceTile& tile);
  void FillBlock(const VertexBlock& block, const TileNeighborhood& surroundings,
                 DistanceTile& tile);
  void FindObstaclesAround(TileKey key);
  void AddSitesAtCorners(const VertexBlock& block, uint64_t lost,
                         const TileNeighborhood& surroundings);
  void AddSitesOfNeighbors(const VertexBlock& block, uint64_t lost, const DistanceTile& tile);
  void AddSitesAround(const VertexBlock& block, uint64_t lost, NearestSites& nearest);
  void AddSitesOfTile(const VertexBlock& block, TileKey from, const Obstacles& obstacles,
                      const VertexBox& of_lost, int middle, NearestSites& nearest,
                      int32_t& end_squared);
  const ObstacleSquares& SquaresAt(TileKey key) const;

  const DistanceFieldOptions options_;
  std::shared_ptr<const MapView> map_ = std::make_shared<const MapView>();
  SurfaceBounds bounds_;
  // To what vertices may be from what counts, in eighths of a knot interval; and in tiles.
  int32_t reach_ = 0;
  int32_t reach_tiles_ = 0;
  // Absent: no square, or where unknown stops, all of them.
  absl::flat_hash_map<TileKey, std::unique_ptr<Obstacles>> obstacles_;
  TileBox obstacles_box_;  // around them
  KeyTreeEditor<DistanceTile> tiles_;
  std::shared_ptr<const DistanceTile> nothing_near_;
  // Of an update, those of a tile side by side.
  std::vector<Change> changes_;
  std::vector<Site> changed_;
  // The tiles that may change, and where in changes_near_ what is near them begins.
  absl::flat_hash_map<TileKey, int> tiles_near_;
  std::vector<ChangesNear> changes_near_;
  // Of the tile that is being updated, by block: what may be nearest to a vertex, or was.
  std::array<std::vector<Site>, kBlocks * kBlocks> came_near_;
  std::array<std::vector<Site>, kBlocks * kBlocks> went_near_;
  // Of the tile that is being updated: the obstacles by tile, null where there are none, and in
  // which box of tiles, from it.
  std::vector<const Obstacles*> obstacles_around_;
  TileBox around_;
  std::vector<Site> sites_;  // of a tile, or near a block, while they are found
  SomeSites some_sites_;
};

}  // namespace splinemap
