#pragma once

#include <utility>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "fmt/format.h"

// Returns from the enclosing function where `expression` is a failed absl::Status.
#define SPLINEMAP_RETURN_IF_ERROR(expression)                               \
  do {                                                                      \
    if (absl::Status status_ = (expression); !status_.ok()) return status_; \
  } while (false)

#define SPLINEMAP_CONCAT_INNER(a, b) a##b
#define SPLINEMAP_CONCAT(a, b) SPLINEMAP_CONCAT_INNER(a, b)

// Assigns the value of an absl::StatusOr, or returns its error from the enclosing function.
#define SPLINEMAP_ASSIGN_OR_RETURN(target, expression)                 \
  auto SPLINEMAP_CONCAT(status_or_, __LINE__) = (expression);          \
  if (!SPLINEMAP_CONCAT(status_or_, __LINE__).ok()) {                  \
    return std::move(SPLINEMAP_CONCAT(status_or_, __LINE__)).status(); \
  }                                                                    \
  target = *std::move(SPLINEMAP_CONCAT(status_or_, __LINE__))

namespace splinemap {

// Debian's Abseil has a string_view of its own, so messages are made with fmt.
template <typename... Args>
absl::Status InvalidArgument(fmt::format_string<Args...> format, Args&&... args) {
  return absl::InvalidArgumentError(fmt::format(format, std::forward<Args>(args)...));
}

template <typename... Args>
absl::Status NotFound(fmt::format_string<Args...> format, Args&&... args) {
  return absl::NotFoundError(fmt::format(format, std::forward<Args>(args)...));
}

template <typename... Args>
absl::Status FailedPrecondition(fmt::format_string<Args...> format, Args&&... args) {
  return absl::FailedPreconditionError(fmt::format(format, std::forward<Args>(args)...));
}

template <typename... Args>
absl::Status DataLoss(fmt::format_string<Args...> format, Args&&... args) {
  return absl::DataLossError(fmt::format(format, std::forward<Args>(args)...));
}

template <typename... Args>
absl::Status Unavailable(fmt::format_string<Args...> format, Args&&... args) {
  return absl::UnavailableError(fmt::format(format, std::forward<Args>(args)...));
}

// The text of a status without its code, as shown to people.
inline std::string ErrorText(const absl::Status& status) {
  return std::string(status.message().data(), status.message().size());
}

}  // namespace splinemap
