#include "tests/soak/doctor/faulty_drive.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <iterator>
#include <limits>
#include <numbers>

#include "fmt/format.h"
#include "lib/base/status.h"
#include "lib/logs/lcm_log.h"
#include "lib/wire/encode.h"

namespace splinemap::doctor_law {
namespace {

using Random = std::mt19937_64;

constexpr double kTurn_rad = 2 * std::numbers::pi;
constexpr double kDegree_rad = std::numbers::pi / 180;
constexpr double kInfinity = std::numeric_limits<double>::infinity();

double Between(double least, double most, Random& random) {
  return std::uniform_real_distribution<double>(least, most)(random);
}

double WithEitherSign(double value, Random& random) { return random() % 2 == 0 ? value : -value; }

template <typename Value>
Value OneOf(std::initializer_list<Value> values, Random& random) {
  return *(values.begin() + random() % values.size());
}

void AddWall(double x0_m, double y0_m, double x1_m, double y1_m, simulation::World& world) {
  simulation::Wall& wall = *world.add_wall();
  wall.set_x0_m(x0_m);
  wall.set_y0_m(y0_m);
  wall.set_x1_m(x1_m);
  wall.set_y1_m(y1_m);
}

void SetMount(Fault& fault, bool moved, bool turned, Random& random) {
  if (moved) {
    fault.robot_T_sensor.position_m = {WithEitherSign(Between(0.1, 0.4, random), random),
                                       WithEitherSign(Between(0.05, 0.3, random), random)};
  }
  if (turned) {
    fault.robot_T_sensor.yaw_rad = WithEitherSign(Between(5, 175, random), random) * kDegree_rad;
  }
}

using MakeFault = void (*)(Fault&, Scanner&, Random&);
struct Kind {
  const char* name;
  MakeFault make;
};

constexpr Kind kSingleKinds[] = {
    {"honest", [](Fault&, Scanner&, Random&) {}},
    {"honest_short_range",
     [](Fault&, Scanner& scanner, Random& random) {
       scanner.range_max_m = Between(3, 6, random);
       scanner.no_return_m = OneOf({0.0, kInfinity, 60.0}, random);
     }},
    {"bearings_reversed", [](Fault& fault, Scanner&, Random&) { fault.is_reversed = true; }},
    {"scans_off_below_1s",
     [](Fault& fault, Scanner&, Random& random) {
       fault.scan_clock_s = WithEitherSign(Between(0.03, 0.9, random), random);
     }},
    {"scans_off_above_1s",
     [](Fault& fault, Scanner&, Random& random) {
       fault.scan_clock_s = WithEitherSign(Between(1.2, 5, random), random);
     }},
    {"clocks_apart",
     [](Fault& fault, Scanner&, Random& random) {
       const double apart_s = WithEitherSign(std::pow(10, Between(1, 6, random)), random);
       (random() % 2 == 0 ? fault.scan_clock_s : fault.pose_clock_s) = apart_s;
     }},
    {"poses_heard_late", [](Fault& fault, Scanner&,
                            Random& random) { fault.poses_late_s = Between(0.2, 1.5, random); }},
    {"ranges_in_mm",
     [](Fault& fault, Scanner&, Random&) {
       fault.ranges_per_m = 1000;
       fault.refusal = "millimetres";
     }},
    {"scan_stamps_in_ms_or_s",
     [](Fault& fault, Scanner&, Random& random) {
       fault.scan_stamps_per_s = OneOf({1e3, 1.0}, random);
     }},
    {"pose_stamps_in_ms_or_s",
     [](Fault& fault, Scanner&, Random& random) {
       fault.pose_stamps_per_s = OneOf({1e3, 1.0}, random);
       fault.refusal = "seconds; messages have microseconds";
     }},
    {"field_of_view_told_too_narrow",
     [](Fault& fault, Scanner& scanner, Random& random) {
       scanner.field_of_view_rad = OneOf({240, 270, 360}, random) * kDegree_rad;
       fault.told_field_of_view_rad = 180 * kDegree_rad;
     }},
    {"upside_down", [](Fault& fault, Scanner&, Random&) { fault.roll_rad = 180 * kDegree_rad; }},
    {"tilted_below_10_deg",
     [](Fault& fault, Scanner&, Random& random) {
       fault.roll_rad = Between(-6, 6, random) * kDegree_rad;
       fault.pitch_rad = Between(-6, 6, random) * kDegree_rad;
     }},
    {"tilted_above_10_deg",
     [](Fault& fault, Scanner&, Random& random) {
       (random() % 2 == 0 ? fault.roll_rad : fault.pitch_rad) =
           WithEitherSign(Between(12, 30, random), random) * kDegree_rad;
       fault.refusal = "tilt the robot by more than 10 degrees";
     }},
    {"mounted_by_quarters",
     [](Fault& fault, Scanner&, Random& random) {
       fault.robot_T_sensor.yaw_rad = OneOf({90, 180, 270}, random) * kDegree_rad;
     }},
    {"mounted_turned",
     [](Fault& fault, Scanner&, Random& random) { SetMount(fault, false, true, random); }},
    {"mounted_off_centre",
     [](Fault& fault, Scanner&, Random& random) { SetMount(fault, true, false, random); }},
    {"mounted_off_centre_and_turned",
     [](Fault& fault, Scanner&, Random& random) { SetMount(fault, true, true, random); }},
    {"other_poses_drift", [](Fault& fault, Scanner&, Random&) { fault.has_drifting_poses = true; }},
    {"other_poses_stamped_late",
     [](Fault& fault, Scanner&, Random& random) {
       fault.other_poses_late_s = Between(0.2, 0.8, random);
     }},
    {"no_return_below_maximum",
     [](Fault& fault, Scanner& scanner, Random& random) {
       scanner.range_max_m = Between(3, 6, random);
       fault.no_return_m = OneOf({scanner.range_max_m - 0.005, 8.0, 29.995}, random);
     }},
    {"scan_takes_time",
     [](Fault& fault, Scanner&, Random& random) {
       fault.scan_duration_s = WithEitherSign(Between(0.03, 0.2, random), random);
     }},
};

// Two of these at once.
constexpr Kind kPairs[] = {
    {"reversed_and_off",
     [](Fault& fault, Scanner&, Random& random) {
       fault.is_reversed = true;
       fault.scan_clock_s = WithEitherSign(Between(0.03, 0.7, random), random);
     }},
    {"reversed_and_turned",
     [](Fault& fault, Scanner&, Random& random) {
       fault.is_reversed = true;
       SetMount(fault, false, true, random);
     }},
    {"turned_and_off",
     [](Fault& fault, Scanner&, Random& random) {
       fault.scan_clock_s = WithEitherSign(Between(0.03, 0.4, random), random);
       SetMount(fault, false, true, random);
     }},
    {"drift_and_off",
     [](Fault& fault, Scanner&, Random& random) {
       fault.has_drifting_poses = true;
       fault.scan_clock_s = WithEitherSign(Between(0.03, 0.7, random), random);
     }},
};

// Messages in the order of reception.
class Recording {
 public:
  template <typename Message>
  void Add(double received_s, const char* channel, const Message& message) {
    events_.push_back({kStart + Utime(std::llround(received_s * 1e6)), channel, Encode(message)});
  }

  absl::Status Write(const std::string& path) {
    std::stable_sort(events_.begin(), events_.end(),
                     [](const Event& a, const Event& b) { return a.received < b.received; });
    SPLINEMAP_ASSIGN_OR_RETURN(LcmLogWriter writer, LcmLogWriter::Create(path));
    for (Event& event : events_) {
      SPLINEMAP_RETURN_IF_ERROR(writer.WriteBytes(event.received, event.channel, event.message));
    }
    return writer.Close();
  }

  static constexpr Utime kStart = std::chrono::seconds(1'700'000'000);

 private:
  struct Event {
    Utime received;
    const char* channel;
    std::vector<uint8_t> message;
  };
  std::vector<Event> events_;
};

Utime Stamp(double time_s, double clock_s, double per_s) {
  const auto start_s = static_cast<double>(Recording::kStart.count()) * 1e-6;
  return Utime(std::llround((start_s + time_s + clock_s) * per_s));
}

Eigen::Quaterniond Attitude(double yaw_rad, const Fault& fault) {
  return Eigen::AngleAxisd(yaw_rad, Eigen::Vector3d::UnitZ()) *
         Eigen::AngleAxisd(fault.pitch_rad, Eigen::Vector3d::UnitY()) *
         Eigen::AngleAxisd(fault.roll_rad, Eigen::Vector3d::UnitX());
}

bot_core::pose_t PoseAt(const Pose2& pose, Utime stamp, const Fault& fault) {
  bot_core::pose_t message = PoseMessage({.utime = stamp, .world_T_robot = pose});
  const Eigen::Quaterniond attitude = Attitude(pose.yaw_rad, fault);
  message.orientation[0] = attitude.w();
  message.orientation[1] = attitude.x();
  message.orientation[2] = attitude.y();
  message.orientation[3] = attitude.z();
  return message;
}

void AddPoses(const Drive& drive, const Fault& fault, Recording& recording) {
  constexpr double kStep_s = 0.025;
  constexpr double kWay_s = 0.003;
  for (int k = 0; k * kStep_s <= drive.duration_s(); ++k) {
    const double time_s = k * kStep_s;
    const double received_s = time_s + kWay_s + fault.poses_late_s;
    const Pose2 pose = drive.PoseAt(time_s);
    const auto add = [&](const char* channel, const Pose2& told, double late_s) {
      const Utime stamp = Stamp(time_s, fault.pose_clock_s + late_s, fault.pose_stamps_per_s);
      recording.Add(received_s, channel, PoseAt(told, stamp, fault));
    };
    add("POSE", pose, 0);
    // A drift of 1 degree and 2 cm a second.
    if (fault.has_drifting_poses) {
      add("ODOMETRY", Pose2{{0.02 * time_s, 0}, kDegree_rad * time_s} * pose, 0);
    }
    if (fault.other_poses_late_s > 0) add("OTHER_POSE", pose, fault.other_poses_late_s);
  }
}

// The reading of one beam, of walls without end in height.
double Measure(const simulation::World& world, const Scanner& scanner, const Fault& fault,
               const Pose2& world_T_robot, double bearing_rad, double noise_m) {
  const double in_robot_rad = bearing_rad + fault.robot_T_sensor.yaw_rad;
  const Eigen::Vector3d direction =
      Attitude(world_T_robot.yaw_rad, fault) *
      Eigen::Vector3d(std::cos(in_robot_rad), std::sin(in_robot_rad), 0);
  const Eigen::Vector2d level = direction.head<2>();
  const std::optional<double> level_m = CastRay(
      world, 0, world_T_robot * fault.robot_T_sensor.position_m, std::atan2(level.y(), level.x()));
  const double range_m = level_m.value_or(kInfinity) / level.norm();
  if (range_m < scanner.range_max_m) return std::max(range_m + noise_m, 0.001);
  return fault.no_return_m >= 0 ? fault.no_return_m : scanner.no_return_m;
}

void AddScans(const simulation::World& world, const Drive& drive, const Scanner& scanner,
              const Fault& fault, Random& random, Recording& recording) {
  constexpr double kStep_s = 0.1;
  const bool is_all_round = scanner.field_of_view_rad > 0.999 * kTurn_rad;
  const int steps = scanner.num_beams;
  const int beams = is_all_round ? steps : steps + 1;
  const double step_rad = scanner.field_of_view_rad / steps;
  const double told_rad =
      fault.told_field_of_view_rad > 0 ? fault.told_field_of_view_rad : scanner.field_of_view_rad;
  const double sign = fault.is_reversed ? -1 : 1;
  std::normal_distribution<double> noise(0, scanner.noise_m);
  for (int k = 0; k * kStep_s <= drive.duration_s(); ++k) {
    const double time_s = k * kStep_s;
    std::vector<float> readings;
    for (int beam = 0; beam < beams; ++beam) {
      // The last beam is the oldest where the duration is negative.
      const double beam_s = time_s + fault.scan_duration_s * beam / (beams - 1);
      const double bearing_rad = beam * step_rad - scanner.field_of_view_rad / 2;
      readings.push_back(static_cast<float>(
          fault.ranges_per_m *
          Measure(world, scanner, fault, drive.PoseAt(beam_s), bearing_rad, noise(random))));
    }
    const double way_s = 0.01 + Between(0, 0.005, random);
    const Utime stamp = Stamp(time_s, fault.scan_clock_s, fault.scan_stamps_per_s);
    recording.Add(time_s + way_s, "LASER",
                  PlanarLidarMessage(stamp, std::move(readings), -sign * told_rad / 2,
                                     sign * told_rad / steps));
  }
}

}  // namespace

Fault Mended(const Fault& fault) {
  Fault mended;
  mended.roll_rad = fault.roll_rad;
  mended.pitch_rad = fault.pitch_rad;
  mended.robot_T_sensor = fault.robot_T_sensor;
  mended.scan_duration_s = fault.scan_duration_s;
  return mended;
}

std::string Describe(const Fault& fault) {
  std::string text = fault.kind;
  const auto add = [&](const char* name, double value) {
    if (value != 0) text += fmt::format(" {}={:.3f}", name, value);
  };
  add("scan_clock_s", fault.scan_clock_s);
  add("pose_clock_s", fault.pose_clock_s);
  add("poses_late_s", fault.poses_late_s);
  add("told_deg", fault.told_field_of_view_rad / kDegree_rad);
  add("duration_s", fault.scan_duration_s);
  add("roll_deg", fault.roll_rad / kDegree_rad);
  add("pitch_deg", fault.pitch_rad / kDegree_rad);
  add("x_m", fault.robot_T_sensor.position_m.x());
  add("y_m", fault.robot_T_sensor.position_m.y());
  add("yaw_deg", fault.robot_T_sensor.yaw_rad / kDegree_rad);
  add("other_poses_late_s", fault.other_poses_late_s);
  return text;
}

simulation::World RandomRoom(Random& random) {
  const double width_m = Between(6, 13, random);
  const double height_m = Between(5, 10, random);
  const double left_m = Between(-20, 20, random);
  const double bottom_m = Between(-20, 20, random);
  const double right_m = left_m + width_m;
  const double top_m = bottom_m + height_m;
  simulation::World world;
  AddWall(left_m, bottom_m, right_m, bottom_m, world);
  AddWall(right_m, bottom_m, right_m, top_m, world);
  AddWall(right_m, top_m, left_m, top_m, world);
  AddWall(left_m, top_m, left_m, bottom_m, world);
  // Walls that reach into the room, up to where the robot drives.
  for (int k = 0; k < 4; ++k) {
    const double x_m = Between(left_m + 0.5, right_m - 0.5, random);
    const double y_m = Between(bottom_m + 0.5, top_m - 0.5, random);
    const double reach = Between(0.08, 0.2, random);
    if (k == 0) AddWall(x_m, bottom_m, x_m, bottom_m + reach * height_m, world);
    if (k == 1) AddWall(x_m, top_m, x_m, top_m - reach * height_m, world);
    if (k == 2) AddWall(left_m, y_m, left_m + reach * width_m, y_m, world);
    if (k == 3 && random() % 2 == 0) AddWall(right_m, y_m, right_m - reach * width_m, y_m, world);
  }
  for (uint64_t k = random() % 3; k > 0; --k) {
    simulation::Pillar& pillar = *world.add_pillar();
    pillar.set_x_m(Between(left_m + 0.4, right_m - 0.4, random));
    pillar.set_y_m(bottom_m + Between(0.05, 0.2, random) * height_m);
    pillar.set_radius_m(Between(0.05, 0.2, random));
  }
  for (int k = 0; k < 11; ++k) {
    simulation::Waypoint& waypoint = *world.add_waypoint();
    waypoint.set_x_m(left_m + Between(0.27, 0.73, random) * width_m);
    waypoint.set_y_m(bottom_m + Between(0.27, 0.73, random) * height_m);
  }
  world.set_speed_mps(Between(0.5, 1, random));
  world.set_turn_rate_degps(Between(45, 100, random));
  return world;
}

Scanner RandomScanner(Random& random) {
  Scanner scanner;
  scanner.num_beams = OneOf({180, 240, 360}, random);
  scanner.field_of_view_rad = OneOf({180, 270, 360}, random) * kDegree_rad;
  scanner.noise_m = Between(0.003, 0.02, random);
  return scanner;
}

int NumKinds() { return static_cast<int>(std::size(kSingleKinds) + std::size(kPairs)); }

Fault RandomFault(int kind, Scanner& scanner, Random& random) {
  const int singles = static_cast<int>(std::size(kSingleKinds));
  const Kind& chosen = kind < singles ? kSingleKinds[kind] : kPairs[kind - singles];
  Fault fault;
  fault.kind = chosen.name;
  chosen.make(fault, scanner, random);
  return fault;
}

absl::Status WriteDrive(const simulation::World& world, const Scanner& scanner, const Fault& fault,
                        uint64_t seed, const std::string& path) {
  SPLINEMAP_ASSIGN_OR_RETURN(const Drive drive, Drive::Plan(world));
  Random random(seed);
  Recording recording;
  AddPoses(drive, fault, recording);
  AddScans(world, drive, scanner, fault, random, recording);
  return recording.Write(path);
}

}  // namespace splinemap::doctor_law
