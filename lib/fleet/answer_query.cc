#include "lib/fleet/answer_query.h"

#include <algorithm>
#include <type_traits>

#include "lib/base/status.h"
#include "lib/fleet/sum_block.h"

namespace splinemap {
namespace {

absl::Status CheckParts(const FleetRequest& request, const PartSet& parts) {
  return std::visit(
      [&](const auto& query) -> absl::Status {
        for (size_t item = 0; item < SizeOf(query); ++item) {
          SPLINEMAP_ASSIGN_OR_RETURN(const TileBoxes boxes,
                                     TilesOfItem(query, item, request.knot_interval_m));
          if ((PartsOf(boxes) & ~parts).any()) {
            return Unavailable("another worker has this part of the map");
          }
        }
        return absl::OkStatus();
      },
      request.query);
}

absl::StatusOr<FleetQueries::AnyAnswer> AnswerRequestOf(const std::string& bytes,
                                                        const LocalMap& map, const PartSet& parts) {
  SPLINEMAP_ASSIGN_OR_RETURN(const FleetRequest request, DecodeRequest(bytes));
  const double knot_interval_m = map.View()->options.knot_interval_m;
  if (request.knot_interval_m != knot_interval_m) {
    return FailedPrecondition(
        "the fleet's map has knots {} m apart, not {} m: it was made anew; connect again",
        knot_interval_m, request.knot_interval_m);
  }
  SPLINEMAP_RETURN_IF_ERROR(CheckParts(request, parts));
  return std::visit([&](const auto& query) { return AnswerHere(&query, map); }, request.query);
}

template <typename Query>
absl::StatusOr<typename Query::Answer> Evaluate(const Query& query, const LocalMap& map) {
  return map.Ask(query);
}

absl::StatusOr<RasterQuery::Answer> Evaluate(const RasterCells& query, const LocalMap& map) {
  PointsQuery points;
  for (const RasterCells::Rectangle& rectangle : query.rectangles) {
    for (int32_t row = rectangle.row0; row < rectangle.row1; ++row) {
      for (int32_t column = rectangle.column0; column < rectangle.column1; ++column) {
        points.points_m.push_back(
            PointOfCell(query.raster, size_t{1} * row * query.raster.width + column));
      }
    }
  }
  SPLINEMAP_ASSIGN_OR_RETURN(const PointsQuery::Answer found, map.Ask(points));
  RasterQuery::Answer answer{.revision = found.revision, .cells = {}};
  answer.cells.reserve(found.samples.size());
  std::transform(found.samples.begin(), found.samples.end(), std::back_inserter(answer.cells),
                 CellOf);
  return answer;
}

absl::StatusOr<BlocksQuery::Answer> Evaluate(const BlocksQuery& query, const LocalMap& map) {
  const std::shared_ptr<const MapView> view = map.View();
  BlocksQuery::Answer answer{.revision = view->revision, .blocks = {}};
  for (const BlockKey& block : query.blocks) {
    SPLINEMAP_ASSIGN_OR_RETURN(answer.blocks.emplace_back(),
                               EncodeBlock(SumBlockOf(view->tiles, block), block, nullptr));
  }
  return answer;
}

}  // namespace

std::string AnswerQuery(const std::string& request, const LocalMap& map, const PartSet& parts) {
  return EncodeReply(AnswerRequestOf(request, map, parts));
}

absl::StatusOr<FleetQueries::AnyAnswer> AnswerHere(const FleetQueries::Any& query,
                                                   const LocalMap& map) {
  return std::visit(
      [&](const auto* q) -> absl::StatusOr<FleetQueries::AnyAnswer> {
        SPLINEMAP_ASSIGN_OR_RETURN(auto answer, Evaluate(*q, map));
        return answer;
      },
      query);
}

}  // namespace splinemap
