#include "lib/base/file.h"

#include <cerrno>
#include <cstdio>
#include <cstring>
#include <filesystem>
#include <memory>
#include <utility>

#include "lib/base/random.h"
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

std::string TemporaryPathFor(const std::string& path) {
  return fmt::format("{}.{:016x}.part", path, RandomId());
}

NewFile::NewFile(std::string path)
    : path_(std::move(path)),
      temporary_path_(TemporaryPathFor(path_)),
      stream_(std::fopen(temporary_path_.c_str(), "wbx")) {}

absl::StatusOr<NewFile> NewFile::Create(std::string path) {
  std::error_code ignored;
  if (std::filesystem::exists(path, ignored) && !std::filesystem::is_regular_file(path, ignored)) {
    return InvalidArgument("cannot write {}: it is no ordinary file", path);
  }
  NewFile file(std::move(path));
  if (!file.stream_) return file.Failure();
  return file;
}

NewFile::~NewFile() {
  if (stream_) std::remove(temporary_path().c_str());
}

absl::Status NewFile::Write(std::string_view content) {
  if (std::fwrite(content.data(), 1, content.size(), stream_.get()) != content.size()) {
    return Failure();
  }
  return absl::OkStatus();
}

absl::Status NewFile::Commit() {
  // A write that was put off may fail as late as here.
  absl::Status status;
  if (std::ferror(stream_.get()) != 0 || std::fflush(stream_.get()) != 0) status = Failure();
  if (std::fclose(stream_.release()) != 0) status.Update(Failure());
  if (status.ok() && std::rename(temporary_path().c_str(), path_.c_str()) != 0) status = Failure();
  if (!status.ok()) std::remove(temporary_path().c_str());
  return status;
}

absl::Status NewFile::Failure() const {
  return Unavailable("cannot write {}: {}", path_, std::strerror(errno));
}

absl::Status WriteFile(const std::string& path, const std::string& content) {
  SPLINEMAP_ASSIGN_OR_RETURN(NewFile file, NewFile::Create(path));
  SPLINEMAP_RETURN_IF_ERROR(file.Write(content));
  return file.Commit();
}

}  // namespace splinemap
