#include "lib/base/file.h"

#include <cerrno>
#include <cstdio>
#include <cstring>
#include <filesystem>
#include <memory>

#include "lib/base/status.h"

namespace splinemap {
namespace {

struct FileCloser {
  void operator()(std::FILE* file) const { std::fclose(file); }
};
using File = std::unique_ptr<std::FILE, FileCloser>;

}  // namespace

absl::StatusOr<std::string> ReadFile(const std::string& path) {
  std::error_code ignored;
  if (std::filesystem::is_directory(path, ignored)) {
    return InvalidArgument("cannot read {}: it is a directory", path);
  }
  File file(std::fopen(path.c_str(), "rb"));
  if (!file) return NotFound("cannot read {}: {}", path, std::strerror(errno));
  std::string content;
  char buffer[1 << 16];
  while (size_t n = std::fread(buffer, 1, sizeof buffer, file.get())) content.append(buffer, n);
  if (std::ferror(file.get())) return DataLoss("cannot read {}: {}", path, std::strerror(errno));
  return content;
}

absl::Status WriteFile(const std::string& path, const std::string& content) {
  const std::string temporary = path + ".part";
  {
    File file(std::fopen(temporary.c_str(), "wb"));
    if (!file) return Unavailable("cannot write {}: {}", path, std::strerror(errno));
    const bool written =
        std::fwrite(content.data(), 1, content.size(), file.get()) == content.size() &&
        std::fflush(file.get()) == 0;
    if (!written) {
      const int error = errno;
      std::remove(temporary.c_str());
      return Unavailable("cannot write {}: {}", path, std::strerror(error));
    }
  }
  if (std::rename(temporary.c_str(), path.c_str()) != 0) {
    const int error = errno;
    std::remove(temporary.c_str());
    return Unavailable("cannot write {}: {}", path, std::strerror(error));
  }
  return absl::OkStatus();
}

}  // namespace splinemap
