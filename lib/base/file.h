#pragma once

#include <cstdio>
#include <memory>
#include <string>
#include <string_view>

#include "absl/status/status.h"
#include "absl/status/statusor.h"

namespace splinemap {

// The whole content of a file. Errors name the path and the system's reason.
absl::StatusOr<std::string> ReadFile(const std::string& path);

// A name beside `path` that nobody else uses, for a file in the making: `path`.PID.RANDOM.part.
// Removes what processes that are dead have left under such names of `path`, with the files of
// SQLite beside it. Whoever makes the file holds a flock on it, which tells that it is alive to
// those who do not see its process.
std::string TemporaryPathFor(const std::string& path);

// From here on SIGINT, SIGTERM and SIGHUP remove the files in the making before they end the
// process. For programs that do not take these signals themselves.
void RemoveTemporaryFilesAtSignals();

// Returns when what the file holds, or which names the folder of `path` has, is on the disk.
// Unavailable where the disk says that it is not. To ask once more mends nothing: the system takes
// the lost pages for written.
absl::Status SyncFile(const std::string& path);
absl::Status SyncFolderOf(const std::string& path);

// A file in the making, under a temporary name beside its own. A reader sees the old content until
// Commit() and the whole new content afterwards, also when the power fails; without a Commit()
// nothing is left behind, unless the process is killed. Errors name the path and the system's
// reason. Thread-compatible.
class NewFile {
 public:
  // InvalidArgument for a folder or a device, which would be replaced.
  static absl::StatusOr<NewFile> Create(std::string path);
  NewFile(NewFile&&) = default;
  NewFile& operator=(NewFile&&) = delete;
  ~NewFile();

  const std::string& path() const { return path_; }
  // For libraries that write by themselves.
  const std::string& temporary_path() const { return temporary_path_; }
  std::FILE* stream() { return stream_.get(); }

  absl::Status Write(std::string_view content);
  // Every later call fails.
  absl::Status Commit();

 private:
  struct Closer {
    void operator()(std::FILE* file) const { std::fclose(file); }
  };

  explicit NewFile(std::string path);
  absl::Status Failure() const;

  std::string path_;
  std::string temporary_path_;
  std::unique_ptr<std::FILE, Closer> stream_;  // null after Commit()
};

// Makes or replaces a file through a NewFile.
absl::Status WriteFile(const std::string& path, const std::string& content);

}  // namespace splinemap
