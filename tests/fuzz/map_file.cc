// A whole map file: a SQLite database of any bytes, looked at and continued.

#include "lib/store/map_file.h"

#include <unistd.h>

#include <filesystem>
#include <fstream>

#include "tests/fuzz/fuzz.h"

namespace splinemap {
namespace {

// A file that is removed with what stands beside it. In memory where the system has such a folder.
class ScratchFile {
 public:
  ScratchFile() : path_((Folder() / ("fuzz_map_" + std::to_string(getpid()))).string()) {}
  ~ScratchFile() { Remove(); }

  void Set(absl::Span<const uint8_t> content) {
    Remove();
    std::ofstream(path_, std::ios::binary)
        .write(reinterpret_cast<const char*>(content.data()), std::ssize(content));
  }
  const std::string& path() const { return path_; }

 private:
  static std::filesystem::path Folder() {
    return std::filesystem::exists("/dev/shm") ? "/dev/shm"
                                               : std::filesystem::temp_directory_path();
  }
  void Remove() {
    for (const char* suffix : {"", "-wal", "-shm", "-journal"}) {
      std::error_code ignored;
      std::filesystem::remove(path_ + suffix, ignored);
    }
  }

  std::string path_;
};

void Run(FuzzInput input) {
  static ScratchFile scratch;
  scratch.Set(input.Rest());
  const absl::StatusOr<LoadedMap> looked_at = ReadMapFile(scratch.path());
  absl::StatusOr<MapFile> file = MapFile::Open(scratch.path());
  if (!file.ok()) return;
  const absl::StatusOr<LoadedMap> loaded = file->Load();
  if (!loaded.ok()) return;
  Require(looked_at.ok(), "a map that can be continued can be looked at");
  if (file->Save(*loaded->map).ok() && file->Close().ok()) {
    const absl::StatusOr<LoadedMap> again = ReadMapFile(scratch.path());
    Require(!again.ok() || again->damages.empty(), "a save mends a damaged map");
  }
}

const FuzzTarget target("map_file", &Run);

}  // namespace
}  // namespace splinemap
