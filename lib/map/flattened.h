#pragma once

#include "splinemap/layer_set.h"

namespace splinemap {

// One layer that is the sum of the set, without settings. Its revision counts the commits that are
// in the sum.
LayerSet Flattened(const LayerSet& set, LayerId id, SessionId session);

}  // namespace splinemap
