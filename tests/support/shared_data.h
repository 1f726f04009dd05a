#pragma once

#include <optional>
#include <string>

namespace splinemap {

// Path of a recorded drive in the shared data folder, as "carmen/intel-corrected.log.gz"; nothing
// where it is not there, and then a test skips.
std::optional<std::string> SharedData(const std::string& name);

// Path of a file in tests/data.
std::string TestData(const std::string& name);

}  // namespace splinemap
