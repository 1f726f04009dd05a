#include "lib/base/file.h"

#include <fcntl.h>
#include <sys/file.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <atomic>
#include <cerrno>
#include <cinttypes>
#include <csignal>
#include <cstdio>
#include <cstring>
#include <filesystem>
#include <memory>
#include <mutex>
#include <utility>

#include "lib/base/random.h"
#include "lib/base/status.h"

namespace splinemap {
namespace {

struct FileCloser {
  void operator()(std::FILE* file) const { std::fclose(file); }
};
using File = std::unique_ptr<std::FILE, FileCloser>;

constexpr std::array<const char*, 4> kBeside{"", "-wal", "-shm", "-journal"};

// The last names that this process has made, for a signal handler, which may neither lock nor
// allocate. A name that is in use no more names nothing.
constexpr size_t kMaxNames = 32;
constexpr size_t kMaxNameBytes = 1024;
std::array<std::array<std::array<char, kMaxNameBytes>, kBeside.size()>, kMaxNames> made_names;
std::atomic<size_t> made_count{0};

void RemoveMade(int signal) {
  for (size_t k = 0; k < std::min(made_count.load(), kMaxNames); ++k) {
    for (const auto& name : made_names[k]) unlink(name.data());
  }
  std::signal(signal, SIG_DFL);
  std::raise(signal);
}

void Remember(const std::string& path) {
  static std::mutex mutex;
  const std::scoped_lock lock(mutex);
  if (path.size() + 16 > kMaxNameBytes) return;
  for (size_t k = 0; k < kBeside.size(); ++k) {
    std::strcpy(made_names[made_count % kMaxNames][k].data(), (path + kBeside[k]).c_str());
  }
  ++made_count;
}

// Whether `name` is one that a process made for `path`, which is dead.
bool IsLeftBehind(const std::string& path, const std::string& name) {
  int pid = 0;
  uint64_t random = 0;
  int end = 0;
  if (!name.starts_with(path) ||
      std::sscanf(name.c_str() + path.size(), ".%d.%16" SCNx64 ".part%n", &pid, &random, &end) !=
          2 ||
      end == 0 || name.size() != path.size() + static_cast<size_t>(end)) {
    return false;
  }
  if (pid <= 0 || kill(pid, 0) == 0 || errno != ESRCH) return false;
  const int file = open(name.c_str(), O_RDONLY | O_NOFOLLOW | O_CLOEXEC);
  if (file < 0) return false;
  const bool is_free = flock(file, LOCK_EX | LOCK_NB) == 0;
  close(file);
  return is_free;
}

absl::Status Sync(const std::string& path, int flags) {
  const int descriptor = open(path.c_str(), flags | O_CLOEXEC);
  const bool is_synced = descriptor >= 0 && fsync(descriptor) == 0;
  const int error = errno;
  if (descriptor >= 0) close(descriptor);
  // The last two: of a file system, or a folder without permission to read, that cannot be asked.
  if (is_synced || error == EINVAL || error == EACCES) return absl::OkStatus();
  return Unavailable("cannot bring {} to the disk: {}", path, std::strerror(error));
}

void RemoveLeftBehind(const std::filesystem::path& path) {
  std::error_code error;
  const std::filesystem::path folder = path.has_parent_path() ? path.parent_path() : ".";
  for (std::filesystem::directory_iterator entry(folder, error), end; entry != end;
       entry.increment(error)) {
    const std::string name = entry->path().filename().string();
    const std::string full = path.has_parent_path() ? (path.parent_path() / name).string() : name;
    if (!IsLeftBehind(path.string(), full)) continue;
    // By its own name it is found, should this not get to its end.
    for (auto beside = kBeside.rbegin(); beside != kBeside.rend(); ++beside) {
      std::remove((full + *beside).c_str());
    }
  }
}

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
  RemoveLeftBehind(path);
  std::string made = fmt::format("{}.{}.{:016x}.part", path, getpid(), RandomId());
  Remember(made);
  return made;
}

void RemoveTemporaryFilesAtSignals() {
  for (const int signal : {SIGINT, SIGTERM, SIGHUP}) {
    // Who was started to ignore one, by nohup say, goes on ignoring it.
    if (std::signal(signal, &RemoveMade) == SIG_IGN) std::signal(signal, SIG_IGN);
  }
}

absl::Status SyncFile(const std::string& path) { return Sync(path, O_RDONLY); }

absl::Status SyncFolderOf(const std::string& path) {
  const std::filesystem::path folder = std::filesystem::path(path).parent_path();
  return Sync(folder.empty() ? "." : folder.string(), O_RDONLY | O_DIRECTORY);
}

NewFile::NewFile(std::string path)
    : path_(std::move(path)),
      temporary_path_(TemporaryPathFor(path_)),
      stream_(std::fopen(temporary_path_.c_str(), "wbx")) {
  if (stream_) flock(fileno(stream_.get()), LOCK_EX | LOCK_NB);
}

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
  if (std::ferror(stream_.get()) != 0 || std::fflush(stream_.get()) != 0 ||
      fsync(fileno(stream_.get())) != 0) {
    status = Failure();
  }
  if (std::fclose(stream_.release()) != 0) status.Update(Failure());
  if (status.ok() && std::rename(temporary_path().c_str(), path_.c_str()) != 0) status = Failure();
  if (!status.ok()) {
    std::remove(temporary_path().c_str());
    return status;
  }
  return SyncFolderOf(path_);
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
