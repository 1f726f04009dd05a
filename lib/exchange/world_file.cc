#include "lib/exchange/world_file.h"

#include "fmt/format.h"

namespace splinemap {

std::string WorldFile(const PixelGrid& grid) {
  return fmt::format("{}\n0\n0\n{}\n{}\n{}\n", grid.pixel_m, -grid.pixel_m, grid.CentreX(0),
                     grid.CentreY(0));
}

}  // namespace splinemap
