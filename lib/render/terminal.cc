#include "lib/render/terminal.h"

#include <algorithm>
#include <cmath>

#include "fmt/format.h"

namespace splinemap {
namespace {

constexpr uint8_t kOccupied = 90;  // a raster value below is rather occupied: p > 0.65

// A block of pixels as one: the most occupied where something is, else the most certainly free.
uint8_t Pool(const Raster& raster, double left, double top, double side) {
  const int column_end = std::min(static_cast<int>(std::ceil(left + side)), raster.grid.width);
  const int row_end = std::min(static_cast<int>(std::ceil(top + side)), raster.grid.height);
  uint8_t least = 255;
  uint8_t greatest = 0;
  for (int row = static_cast<int>(top); row < row_end; ++row) {
    for (int column = static_cast<int>(left); column < column_end; ++column) {
      const uint8_t value = raster.at(column, row);
      if (value == Raster::kUnknown) continue;
      least = std::min(least, value);
      greatest = std::max(greatest, value);
    }
  }
  if (greatest == 0) return Raster::kUnknown;
  return least < kOccupied ? least : greatest;
}

int TerminalColour(uint8_t value) {
  constexpr int kUnknownColour = 110;  // blue-grey
  constexpr int kGreyRamp = 232;       // 24 greys from here
  return value == Raster::kUnknown ? kUnknownColour : kGreyRamp + value * 23 / 255;
}

}  // namespace

std::string DrawInTerminal(const Raster& raster, int columns, int rows, bool colour) {
  // A character is about twice as high as wide: one block wide and two high.
  const double side = std::max(
      {double{1} * raster.grid.width / columns, double{1} * raster.grid.height / (2 * rows), 1.0});
  std::string text;
  for (int row = 0; row * 2 * side < raster.grid.height; ++row) {
    for (int column = 0; column * side < raster.grid.width; ++column) {
      const uint8_t upper = Pool(raster, column * side, 2 * row * side, side);
      const uint8_t lower = Pool(raster, column * side, (2 * row + 1) * side, side);
      if (colour) {
        text += fmt::format("\x1b[38;5;{};48;5;{}m\u2580", TerminalColour(upper),
                            TerminalColour(lower));
      } else if (upper == Raster::kUnknown && lower == Raster::kUnknown) {
        text += ' ';
      } else {
        const bool occupied = (upper != Raster::kUnknown && upper < kOccupied) ||
                              (lower != Raster::kUnknown && lower < kOccupied);
        text += occupied ? '#' : '.';
      }
    }
    text += colour ? "\x1b[0m\n" : "\n";
  }
  return text;
}

}  // namespace splinemap
