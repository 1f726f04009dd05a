// A map of map_server: the text of its .yaml, a zero, and its picture. Known cells make a surface.

#include "lib/exchange/ros_grid.h"

#include <algorithm>
#include <string>

#include "tests/fuzz/fuzz.h"

namespace splinemap::fuzz_ros_grid {

void Run(FuzzInput input) {
  static MemoryFile yaml;
  static MemoryFile picture;
  const absl::Span<const uint8_t> bytes = input.Rest();
  const auto end = std::find(bytes.begin(), bytes.end(), 0);
  std::string text(bytes.begin(), end);
  if (end != bytes.end()) picture.Set(absl::MakeSpan(end + 1, bytes.end()));
  // The name of the picture in the text is that of the file.
  if (const size_t at = text.find("PICTURE"); at != std::string::npos) {
    text.replace(at, 7, picture.path());
  }
  yaml.Set({reinterpret_cast<const uint8_t*>(text.data()), text.size()});
  const absl::StatusOr<RosGrid> grid = ReadRosGrid(yaml.path());
  if (!grid.ok()) return;
  Require(std::ssize(grid->per_cent) == int64_t{1} * grid->width * grid->height, "all cells");
  constexpr double kMaxSide_m = 10;  // larger ones take long
  if (std::max(grid->width, grid->height) * grid->cell_m > kMaxSide_m) return;
  const MapOptions options;
  const absl::StatusOr<TileTree> tiles = TilesOf(*grid, {}, options);
  if (!tiles.ok()) return;
  tiles->ForEach([](TileKey, const TileTree::Entry& entry) {
    Require(CountTouched(*entry.tile->Get()) > 0, "a tile has something");
  });
}

const FuzzTarget target("ros_grid", &Run);

}  // namespace splinemap::fuzz_ros_grid
