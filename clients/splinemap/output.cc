#include <filesystem>

#include "clients/splinemap/commands.h"
#include "lib/base/status.h"

namespace splinemap {

absl::Status CheckOutput(const std::string& path, bool force) {
  std::error_code error;
  const std::filesystem::path folder = std::filesystem::absolute(path, error).parent_path();
  if (!std::filesystem::is_directory(folder, error)) {
    return InvalidArgument("cannot write {}: there is no folder {}", path, folder.string());
  }
  if (!std::filesystem::exists(path, error)) return absl::OkStatus();
  if (!std::filesystem::is_regular_file(path, error)) {
    return InvalidArgument("cannot write {}: it is no ordinary file", path);
  }
  if (!force) return InvalidArgument("{} exists; --force replaces it", path);
  return absl::OkStatus();
}

}  // namespace splinemap
