// A whole map file: a SQLite database of any bytes, looked at and continued.

#include <unistd.h>

#include <filesystem>
#include <fstream>

#include "splinemap/file.h"
#include "tests/fuzz/fuzz.h"

namespace splinemap::fuzz_map_file {

// A file in a folder that is removed with all that comes to stand in it. In memory where the system
// has such a folder.
class ScratchFile {
 public:
  ScratchFile() : folder_(Folder() / ("fuzz_map_" + std::to_string(getpid()))) {}
  ~ScratchFile() { Remove(); }

  void Set(absl::Span<const uint8_t> content) {
    Remove();
    std::filesystem::create_directory(folder_);
    std::ofstream(path(), std::ios::binary)
        .write(reinterpret_cast<const char*>(content.data()), std::ssize(content));
  }
  std::string path() const { return (folder_ / "map").string(); }

 private:
  static std::filesystem::path Folder() {
    return std::filesystem::exists("/dev/shm") ? "/dev/shm"
                                               : std::filesystem::temp_directory_path();
  }
  void Remove() {
    std::error_code ignored;
    std::filesystem::remove_all(folder_, ignored);
  }

  std::filesystem::path folder_;
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
  if (file->Save(loaded->set).ok() && file->Close().ok()) {
    const absl::StatusOr<LoadedMap> again = ReadMapFile(scratch.path());
    Require(!again.ok() || again->corruption.empty(), "a save mends a damaged map");
  }
}

const FuzzTarget target("map_file", &Run);

}  // namespace splinemap::fuzz_map_file
