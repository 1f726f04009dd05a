#pragma once

#include <cstdint>
#include <memory>
#include <random>

#include "splinemap/map_view.h"
#include "splinemap/queries.h"

namespace splinemap {

// A map of one layer, "robot", within 10 m of the origin.
std::shared_ptr<const MapView> RandomMap(uint64_t seed);

// Queries of that many items in and around it. A raster has that many cells, or up to a row more.
PointsQuery RandomPoints(std::mt19937_64& random, size_t size);
RaysQuery RandomRays(std::mt19937_64& random, size_t size);
SweepsQuery RandomSweeps(std::mt19937_64& random, size_t size);
RasterQuery RandomRaster(std::mt19937_64& random, size_t size);
LikelihoodsQuery RandomLikelihoods(std::mt19937_64& random, size_t size);
DistancesQuery RandomDistances(std::mt19937_64& random, size_t size);

// Equal to the last bit, revision too.
bool AreSame(const PointsQuery::Answer& a, const PointsQuery::Answer& b);
bool AreSame(const RaysQuery::Answer& a, const RaysQuery::Answer& b);
bool AreSame(const SweepsQuery::Answer& a, const SweepsQuery::Answer& b);
bool AreSame(const RasterQuery::Answer& a, const RasterQuery::Answer& b);
bool AreSame(const LikelihoodsQuery::Answer& a, const LikelihoodsQuery::Answer& b);
bool AreSame(const DistancesQuery::Answer& a, const DistancesQuery::Answer& b);

}  // namespace splinemap
