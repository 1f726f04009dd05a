#pragma once

#include "absl/status/statusor.h"
#include "lib/query/queries.h"

namespace splinemap {

// A map that can be asked: in this process, a replica, or that of a daemon. All of them give the
// same answers to the last bit. Thread-safe. Errors: InvalidArgument as Check() says; what a map
// over a bus adds, see MapClient.
class QueryableMap {
 public:
  virtual ~QueryableMap() = default;

  virtual absl::StatusOr<PointsQuery::Answer> Ask(const PointsQuery& query) const = 0;
  virtual absl::StatusOr<RaysQuery::Answer> Ask(const RaysQuery& query) const = 0;
  virtual absl::StatusOr<SweepsQuery::Answer> Ask(const SweepsQuery& query) const = 0;
  virtual absl::StatusOr<RasterQuery::Answer> Ask(const RasterQuery& query) const = 0;
  virtual absl::StatusOr<LikelihoodsQuery::Answer> Ask(const LikelihoodsQuery& query) const = 0;
  virtual absl::StatusOr<DistancesQuery::Answer> Ask(const DistancesQuery& query) const = 0;
};

}  // namespace splinemap
