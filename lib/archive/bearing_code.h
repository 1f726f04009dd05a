#pragma once

#include <vector>

#include "lib/archive/bit_stream.h"
#include "splinemap/scan.h"

namespace splinemap {

// The bearings of a scan's beams, of which there is one at least, and whose readings are set. False
// where they cannot be.
void PutBearings(const std::vector<Beam>& beams, BitWriter& writer);
bool TakeBearings(BitReader& reader, std::vector<Beam>& beams);

}  // namespace splinemap
