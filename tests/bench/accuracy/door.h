#pragma once

#include <string>
#include <vector>

#include "tests/bench/accuracy/effort.h"
#include "tests/bench/accuracy/tested_map.h"

namespace splinemap {

// Scans that it takes until most of a door's points are seen as what they are.
struct DoorScans {
  int until_closed = 0;
  int until_open = 0;
};

// A robot stands 1 m before a door, 0.9 m wide, in the wall of a corridor; noise of ranges 1 cm,
// resolution 0.05 m. It sees the door open for `before` scans, then closed until the door is
// occupied (s > 0), and `before` more; then open until the door is free (s < 0).
// effort.max_door_scans where it takes longer.
DoorScans CountDoorScans(const Method& method, int before, const Effort& effort);

// door.csv: the counts by method and by the number of scans before.
void WriteDoor(const std::vector<Method>& methods, const Effort& effort, const std::string& out);

}  // namespace splinemap
