#pragma once

#include <string>

#include "absl/status/statusor.h"
#include "lib/fleet/query_records.h"
#include "lib/fleet/query_tiles.h"
#include "splinemap/local_map.h"

namespace splinemap {

// The reply to a request, as a worker gives it whose `map` is complete in `parts`: an answer, or
// why there is none. Unavailable where tiles of other parts decide the answer, FailedPrecondition
// for a map of another knot interval. Whatever the bytes are, of bounded size and work.
std::string AnswerQuery(const std::string& request, const LocalMap& map, const PartSet& parts);

// What a map in this process says to it.
absl::StatusOr<FleetQueries::AnyAnswer> AnswerHere(const FleetQueries::Any& query,
                                                   const LocalMap& map);

}  // namespace splinemap
