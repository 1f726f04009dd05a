#include "tests/support/shared_data.h"

#include <filesystem>

namespace splinemap {

std::optional<std::string> SharedData(const std::string& name) {
  std::string path = std::string(SPLINEMAP_SHARED_DATA) + "/" + name;
  if (!std::filesystem::exists(path)) return std::nullopt;
  return path;
}

std::string TestData(const std::string& name) {
  return std::string(SPLINEMAP_TEST_DATA) + "/" + name;
}

}  // namespace splinemap
