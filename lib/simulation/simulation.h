#pragma once

#include <cstdint>
#include <numbers>
#include <optional>
#include <random>
#include <vector>

#include "absl/status/statusor.h"
#include "lib/simulation/world.pb.h"
#include "splinemap/pose2.h"

namespace splinemap {

// An office floor of 24 x 13 m: corridor, six rooms, a hall with round pillars, tables and chairs
// on legs of 5 cm, a door that closes while the robot is away, and a drive of about two minutes.
simulation::World OfficeFloor();

// The robot's motion through a world. Immutable.
class Drive {
 public:
  // InvalidArgument where the world has no waypoint.
  static absl::StatusOr<Drive> Plan(const simulation::World& world);

  double duration_s() const { return duration_s_; }
  // Pose at a time, which is clamped to [0, duration_s()].
  Pose2 PoseAt(double time_s) const;

 private:
  struct Leg {
    double begin_s;
    double end_s;
    Pose2 from;
    Pose2 to;  // a straight line, a turn or a wait
  };

  void Append(double duration_s, const Pose2& to);

  std::vector<Leg> legs_;
  Pose2 last_;
  double duration_s_ = 0;
};

struct ScannerOptions {
  int num_beams = 360;      // over a full turn, the first to the back, counter-clockwise
  double range_max_m = 12;  // beyond, the range is 0: no return
  double noise_sigma_m = 0.01;

  double FirstBearing() const { return -std::numbers::pi; }
  double BearingStep() const { return 2 * std::numbers::pi / num_beams; }
};

// Distance along the ray to the first wall or pillar that is there at `time_s`, or nothing.
std::optional<double> CastRay(const simulation::World& world, double time_s,
                              const Eigen::Vector2d& origin, double bearing_rad);

// The ranges of one sweep, in metres, all taken at `time_s`.
std::vector<float> SimulateScan(const simulation::World& world, double time_s, const Pose2& pose,
                                const ScannerOptions& options, std::mt19937_64& random);

}  // namespace splinemap
