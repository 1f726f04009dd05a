#pragma once

namespace splinemap {

// How much of the benchmark is run.
struct Effort {
  int room_scans = 500;
  int runs = 33;
  int default_runs = 7;         // of Fig. 5 for the table of defaults
  int max_log_scans = 1 << 30;  // of each recorded drive
  int max_door_scans = 2000;
  int gp_points = 1500;
  int drives = 4;  // 1 is Intel alone

  static Effort Quick() { return {5, 2, 1, 20, 15, 200, 1}; }
};

}  // namespace splinemap
