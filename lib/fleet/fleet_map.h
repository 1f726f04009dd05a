#pragma once

#include <chrono>
#include <functional>
#include <memory>
#include <string>

#include "absl/status/statusor.h"
#include "lib/base/clock.h"
#include "lib/fleet/fleet_address.h"
#include "lib/fleet/query_records.h"
#include "splinemap/layer_set.h"
#include "splinemap/queryable_map.h"

namespace splinemap {

// The subject on which the workers of a part are asked.
std::string AskSubject(const std::string& map, int part);

// The map of a fleet, asked of its workers. What lies in one part of the map, a worker answers; of
// what reaches over several, the summed tiles come from the workers of each, and the answer is made
// here. So answers are those of a map in this process, to the last bit. An answer that several
// workers had part in may join states that are some milliseconds apart; its revision is the
// greatest of theirs. Thread-safe.
//
// Errors: InvalidArgument as Check() says, and for what needs more than kMaxBlocks of tiles for one
// point, ray, sweep, pose or distance; Unavailable where no worker answered until the deadline;
// FailedPrecondition where the fleet's map was made anew with another knot interval.
class FleetMap : public QueryableMap {
 public:
  // For one item: 65,536 tiles, 410 x 410 m at 5 cm.
  static constexpr size_t kMaxBlocks = 4096;

  // Asks the workers of a part: Unavailable or DeadlineExceeded where none answers in time.
  using Transport = std::function<absl::StatusOr<std::string>(int part, const std::string& request,
                                                              std::chrono::milliseconds deadline)>;

  // Errors of NatsFleetStore::Connect(); NotFound where the servers have no such map. Each call of
  // AskAny() has until `deadline`.
  static absl::StatusOr<std::unique_ptr<FleetMap>> Connect(const FleetAddress& address,
                                                           std::chrono::milliseconds deadline);
  // `ask` is called from several threads.
  FleetMap(const MapOptions& options, Transport ask, std::chrono::milliseconds deadline);

  const MapOptions& options() const { return options_; }
  absl::StatusOr<AnyAnswer> AskAny(const AnyQuery& query) const override;

 private:
  template <typename Query>
  absl::StatusOr<typename Query::Answer> Answer(const Query& query) const;
  absl::StatusOr<RasterQuery::Answer> Answer(const RasterQuery& query) const;
  template <typename Query>
  class Asking;
  absl::StatusOr<FleetQueries::AnyAnswer> AskPart(int part, const FleetQueries::Any& query,
                                                  Clock::time_point end) const;

  const MapOptions options_;
  const Transport ask_;
  const std::chrono::milliseconds deadline_;
};

}  // namespace splinemap
