#pragma once

// Queries, and the map in this process that answers them.
#include "splinemap/local_map.h"      // IWYU pragma: export
#include "splinemap/queries.h"        // IWYU pragma: export
#include "splinemap/queryable_map.h"  // IWYU pragma: export
