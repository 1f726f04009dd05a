#pragma once

#include <bitset>
#include <cstddef>
#include <vector>

#include "absl/status/statusor.h"
#include "lib/fleet/fleet_key.h"
#include "lib/fleet/query_records.h"
#include "splinemap/queries.h"
#include "splinemap/region.h"

// Which tiles decide the answer to one item of a query: a map that has these alone gives the same
// answer, to the last bit, as one that has others, too. They are more than the item touches: bounds
// of a tile are made of those around it.

namespace splinemap {

using TileBoxes = std::vector<TileBox>;
using PartSet = std::bitset<kParts>;

// Item `item` of the query: a point, ray, sweep, pose, or rectangle of cells. Requires
// Check(query).ok(). InvalidArgument for what is too long.
absl::StatusOr<TileBoxes> TilesOfItem(const PointsQuery& query, size_t item,
                                      double knot_interval_m);
absl::StatusOr<TileBoxes> TilesOfItem(const RaysQuery& query, size_t item, double knot_interval_m);
absl::StatusOr<TileBoxes> TilesOfItem(const SweepsQuery& query, size_t item,
                                      double knot_interval_m);
absl::StatusOr<TileBoxes> TilesOfItem(const RasterCells& query, size_t item,
                                      double knot_interval_m);
absl::StatusOr<TileBoxes> TilesOfItem(const LikelihoodsQuery& query, size_t item,
                                      double knot_interval_m);
absl::StatusOr<TileBoxes> TilesOfItem(const DistancesQuery& query, size_t item,
                                      double knot_interval_m);
absl::StatusOr<TileBoxes> TilesOfItem(const BlocksQuery& query, size_t item,
                                      double knot_interval_m);

inline size_t SizeOf(const PointsQuery& query) { return query.points_m.size(); }
inline size_t SizeOf(const RaysQuery& query) { return query.rays.size(); }
inline size_t SizeOf(const SweepsQuery& query) { return query.sweeps.size(); }
inline size_t SizeOf(const RasterCells& query) { return query.rectangles.size(); }
inline size_t SizeOf(const LikelihoodsQuery& query) { return query.world_T_robot.size(); }
inline size_t SizeOf(const DistancesQuery& query) { return query.points_m.size(); }
inline size_t SizeOf(const BlocksQuery& query) { return query.blocks.size(); }

// The parts that have the tiles.
PartSet PartsOf(const TileBoxes& boxes);

// Rectangles of cells that make up the raster, each small enough for one request. As many as can be
// have their tiles in one part. InvalidArgument for too many.
absl::StatusOr<RasterCells> RectanglesOf(const RasterQuery& query, double knot_interval_m);

}  // namespace splinemap
