#pragma once

// Layers and their sum, and the parts that they are made of.
#include "splinemap/layer_set.h"  // IWYU pragma: export
#include "splinemap/map_view.h"   // IWYU pragma: export
#include "splinemap/region.h"     // IWYU pragma: export
