#include "tests/support/temporary_directory.h"

#include <cstdlib>
#include <filesystem>
#include <stdexcept>

namespace splinemap {

TemporaryDirectory::TemporaryDirectory()
    : path_((std::filesystem::temp_directory_path() / "splinemap_test_XXXXXX").string()) {
  if (mkdtemp(path_.data()) == nullptr) throw std::runtime_error("no temporary directory");
}

TemporaryDirectory::~TemporaryDirectory() {
  std::error_code ignored;
  std::filesystem::remove_all(path_, ignored);
}

int TemporaryDirectory::CountFiles() const {
  using Iterator = std::filesystem::directory_iterator;
  return static_cast<int>(std::distance(begin(Iterator(path_)), end(Iterator())));
}

}  // namespace splinemap
