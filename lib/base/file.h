#pragma once

#include <string>

#include "absl/status/status.h"
#include "absl/status/statusor.h"

namespace splinemap {

// The whole content of a file. Errors name the path and the system's reason.
absl::StatusOr<std::string> ReadFile(const std::string& path);

// Writes through a temporary file beside `path`, so that a reader sees the old content or the new
// and a failure leaves the old.
absl::Status WriteFile(const std::string& path, const std::string& content);

}  // namespace splinemap
