#pragma once

#include <string>

#include "lib/render/pixel_grid.h"

namespace splinemap {

// The content of a world file (BASE.pgw beside BASE.png), which tells geographic programs where a
// picture lies: six lines, the size of a pixel, no rotation, the centre of the upper left pixel.
std::string WorldFile(const PixelGrid& grid);

}  // namespace splinemap
