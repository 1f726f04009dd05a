#pragma once

#include <string>

namespace splinemap {

// How much of the benchmark is run.
struct DoorEffort {
  int scans_before = 200;  // of each robot
  int max_scans = 500;
};

// door_votes.csv: some robots saw a door open, scans_before each from places of their own, and went
// away. Another robot stands before it and sees it closed: scans until the merged map says so of
// most of the door's points, and of all of them (-1 where they are not enough); and how many such
// robots it takes, which saw it closed for long. The same of a closed door that opened. `itself` is
// 1 where that robot had seen the door before as the others did.
void WriteDoorVotes(const DoorEffort& effort, const std::string& out);

}  // namespace splinemap
