#pragma once

#include <map>
#include <string>
#include <string_view>

#include "absl/status/statusor.h"

namespace splinemap {

// "/api/query?x=1&y=2", taken apart and percent-decoded (RFC 3986).
struct HttpTarget {
  static constexpr size_t kMaxBytes = 2048;

  std::string path;
  std::map<std::string, std::string> parameters;

  // InvalidArgument for what is no path, is longer than kMaxBytes, or names a parameter twice.
  static absl::StatusOr<HttpTarget> Parse(std::string_view target);

  // A parameter that is a finite number; InvalidArgument where it is missing or is none.
  absl::StatusOr<double> Number(const std::string& name) const;
  absl::StatusOr<double> NumberOr(const std::string& name, double otherwise) const;
};

}  // namespace splinemap
