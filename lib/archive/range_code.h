#pragma once

#include <vector>

#include "lib/archive/bit_stream.h"
#include "splinemap/scan.h"

namespace splinemap {

// The ranges of a scan's beams, of which there is one at least. False where they cannot be.
void PutRanges(const std::vector<Beam>& beams, BitWriter& writer);
bool TakeRanges(BitReader& reader, std::vector<Beam>& beams);

}  // namespace splinemap
