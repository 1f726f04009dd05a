#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstdio>
#include <cstring>
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
  if (access(folder.c_str(), W_OK) != 0) {
    return Unavailable("cannot write {}: {}", path, std::strerror(errno));
  }
  if (!std::filesystem::exists(path, error)) return absl::OkStatus();
  if (!std::filesystem::is_regular_file(path, error)) {
    return InvalidArgument("cannot write {}: it is no ordinary file", path);
  }
  if (!force) return InvalidArgument("{} exists; --force replaces it", path);
  return absl::OkStatus();
}

int ReportDamages(const LoadedMap& loaded) {
  constexpr size_t kMaxLines = 20;
  const size_t count = loaded.damages.size();
  for (size_t k = 0; k < std::min(count, kMaxLines); ++k) {
    fmt::print(stderr, "{}\n", loaded.damages[k]);
  }
  if (count > kMaxLines) fmt::print(stderr, "and {} more\n", count - kMaxLines);
  return count == 0 ? kSuccess : kFailed;
}

}  // namespace splinemap
