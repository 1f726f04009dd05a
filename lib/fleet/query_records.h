#pragma once

#include <cstdint>
#include <string>
#include <variant>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "lib/fleet/fleet_key.h"
#include "lib/rpc/messages.h"
#include "splinemap/queries.h"

// What a worker of a fleet is asked, as bytes (queries.proto).

namespace splinemap {

// Cells of a raster, rectangle by rectangle: the part of a RasterQuery that a worker answers.
struct RasterCells {
  static constexpr size_t kMaxCells = 30'000;  // of one request

  // Columns [column0, column1), rows [row0, row1).
  struct Rectangle {
    int32_t column0 = 0;
    int32_t row0 = 0;
    int32_t column1 = 0;
    int32_t row1 = 0;
    size_t size() const { return size_t{1} * (column1 - column0) * (row1 - row0); }
  };
  RasterQuery raster;
  std::vector<Rectangle> rectangles;

  using Answer = RasterQuery::Answer;  // of one rectangle after the other, along rows
};

// Summed tiles, to evaluate what no single worker has all tiles of.
struct BlocksQuery {
  // Of one request: what is hard to compress fits a message of 1 MiB.
  static constexpr size_t kMaxBlocks = 24;

  std::vector<BlockKey> blocks;

  struct Answer {
    uint64_t revision = 0;
    std::vector<std::string> blocks;  // EncodeBlock() of no layer
  };
};

// In the rest, as Check() and Split() of the other kinds.
absl::Status Check(const RasterCells& query);
absl::Status Check(const BlocksQuery& query);
std::vector<Chunk> Split(const RasterCells& query);  // of rectangles
std::vector<Chunk> Split(const BlocksQuery& query);

// All that a worker answers.
using FleetQueries = QueryList<PointsQuery, RaysQuery, SweepsQuery, RasterCells, LikelihoodsQuery,
                               DistancesQuery, BlocksQuery>;
using FleetQuery = std::variant<PointsQuery, RaysQuery, SweepsQuery, RasterCells, LikelihoodsQuery,
                                DistancesQuery, BlocksQuery>;

// What is asked, of the map of that knot interval. Requires what one chunk of Split() has.
std::string EncodeRequest(const FleetQueries::Any& query, double knot_interval_m);
struct FleetRequest {
  double knot_interval_m = 0;
  FleetQuery query;
};
// InvalidArgument for what is no request, what Check() does not let pass, and for more than a
// chunk. Allocates no more than some times the bytes.
absl::StatusOr<FleetRequest> DecodeRequest(const std::string& bytes);

// An answer, or why there is none.
std::string EncodeReply(const absl::StatusOr<FleetQueries::AnyAnswer>& answer);
// The status that the worker replied with; DataLoss for what does not answer `query`.
absl::StatusOr<FleetQueries::AnyAnswer> DecodeReply(const std::string& bytes,
                                                    const FleetQueries::Any& query);

}  // namespace splinemap
