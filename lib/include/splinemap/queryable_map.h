#pragma once

#include <utility>
#include <variant>

#include "absl/status/statusor.h"
#include "splinemap/queries.h"

namespace splinemap {

// A map that answers queries: in this process, a replica, or that of a daemon. All of them give the
// same answers to the last bit. Thread-safe. Errors: InvalidArgument as Check() says; what a map
// over a bus adds, see MapClient.
class QueryableMap {
 public:
  virtual ~QueryableMap() = default;

  template <typename Query>
  absl::StatusOr<typename Query::Answer> Ask(const Query& query) const {
    absl::StatusOr<AnyAnswer> answer = AskAny(&query);
    if (!answer.ok()) return answer.status();
    return std::get<typename Query::Answer>(*std::move(answer));
  }

  // The answer is of the query's kind.
  virtual absl::StatusOr<AnyAnswer> AskAny(const AnyQuery& query) const = 0;
};

}  // namespace splinemap
