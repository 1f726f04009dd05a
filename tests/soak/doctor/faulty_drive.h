#pragma once

#include <cstdint>
#include <random>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "lib/simulation/simulation.h"

namespace splinemap::doctor_law {

// A scanner, and what its honest messages say.
struct Scanner {
  int num_beams = 180;           // and one more where they are not all round
  double field_of_view_rad = 0;  // the first beam at minus half of it
  double range_max_m = 30;
  double no_return_m = 0;  // the reading of a beam that hits nothing
  double noise_m = 0.01;
};

// What is wrong with the messages of a drive. The default is an honest one.
struct Fault {
  std::string kind = "none";
  // What doctor has to say where the messages cannot be mapped with any flags.
  std::string refusal;

  bool is_reversed = false;  // bearings turn clockwise
  double scan_clock_s = 0;   // ahead of the true one
  double pose_clock_s = 0;
  double poses_late_s = 0;  // on their way
  double ranges_per_m = 1;
  double scan_stamps_per_s = 1e6;
  double pose_stamps_per_s = 1e6;
  double told_field_of_view_rad = 0;  // 0: as it is
  double scan_duration_s = 0;         // from the first beam to the last; negative: from the last
  double roll_rad = 0;                // of the robot, which its poses tell
  double pitch_rad = 0;
  Pose2 robot_T_sensor;             // which nothing tells
  double no_return_m = -1;          // in place of the scanner's
  bool has_drifting_poses = false;  // on ODOMETRY
  double other_poses_late_s = 0;    // stamps on OTHER_POSE; 0: there is no such channel
};

// The same sensor on the same robot, with honest messages.
Fault Mended(const Fault& fault);

// Its numbers, for the table.
std::string Describe(const Fault& fault);

// A room with some inner walls and pillars, and a drive of about 40 s in its middle.
simulation::World RandomRoom(std::mt19937_64& random);

Scanner RandomScanner(std::mt19937_64& random);

// The kinds of faults, by number; Fault::kind names them.
int NumKinds();
Fault RandomFault(int kind, Scanner& scanner, std::mt19937_64& random);

// Writes LASER (bot_core.planar_lidar_t, 10 Hz) and POSE (bot_core.pose_t, 40 Hz) and what else the
// fault says. The same seed gives the same noise, whatever the fault.
absl::Status WriteDrive(const simulation::World& world, const Scanner& scanner, const Fault& fault,
                        uint64_t seed, const std::string& path);

}  // namespace splinemap::doctor_law
