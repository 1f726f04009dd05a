#pragma once

#include <string>

#include "lib/render/raster.h"

namespace splinemap {

// A small picture in text of at most `columns` x `rows` characters, scaled down so that walls do
// not vanish. With `colour`: half blocks in the 256 colours of terminals. Without: '#' occupied,
// '.' free, ' ' unknown. Requires columns, rows >= 1.
std::string DrawInTerminal(const Raster& raster, int columns, int rows, bool colour);

}  // namespace splinemap
