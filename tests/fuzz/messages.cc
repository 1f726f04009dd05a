#include "tests/fuzz/messages.h"

#include <algorithm>
#include <cmath>
#include <vector>

#include "lcmtypes/bot_core/rigid_transform_t.hpp"
#include "lcmtypes/michigan/lidar_t.hpp"
#include "lcmtypes/michigan/pose_xyt_t.hpp"
#include "lib/wire/encode.h"

namespace splinemap {
namespace {

using Message = std::vector<uint8_t>;
using std::chrono::milliseconds;

constexpr size_t kMaxBeamsTaken = 64;

// A number near 0, an odd one, or any bytes.
template <typename Number>
Number ReadNumber(FuzzInput& input) {
  const uint8_t choice = input.Byte();
  if (choice == 0xff) return input.Take<Number>();
  return static_cast<Number>(static_cast<int8_t>(choice)) / Number{4};
}

Message Pose(FuzzInput& input, Utime utime) {
  const auto x_m = ReadNumber<double>(input);
  const auto y_m = ReadNumber<double>(input);
  return Encode(PoseMessage({utime, {{x_m, y_m}, ReadNumber<double>(input)}}));
}

Message MichiganPose(FuzzInput& input, Utime utime) {
  michigan::pose_xyt_t message{};
  message.utime = utime.count();
  message.x = ReadNumber<float>(input);
  message.y = ReadNumber<float>(input);
  message.theta = ReadNumber<float>(input);
  return Encode(message);
}

Message PlanarScan(FuzzInput& input, Utime utime) {
  std::vector<float> ranges_m(input.Byte() % kMaxBeamsTaken);
  for (float& range_m : ranges_m) range_m = ReadNumber<float>(input);
  const auto first_rad = ReadNumber<double>(input);
  return Encode(PlanarLidarMessage(utime, ranges_m, first_rad, ReadNumber<double>(input)));
}

void AddBeam(michigan::lidar_t& message, float range_m, float theta_rad, Utime utime) {
  ++message.num_ranges;
  message.ranges.push_back(range_m);
  message.thetas.push_back(theta_rad);
  message.times.push_back(utime.count());
  message.intensities.push_back(0);
}

Message MichiganScan(FuzzInput& input, Utime utime) {
  michigan::lidar_t message{};
  message.utime = utime.count();
  for (size_t beams = input.Byte() % kMaxBeamsTaken; beams > 0; --beams) {
    const auto range_m = ReadNumber<float>(input);
    const auto theta_rad = ReadNumber<float>(input);
    AddBeam(message, range_m, theta_rad, ReadUtime(input, utime));
  }
  return Encode(message);
}

Message Mount(FuzzInput& input, Utime utime) {
  bot_core::rigid_transform_t message{};
  message.utime = utime.count();
  for (double& coordinate : message.trans) coordinate = ReadNumber<double>(input);
  const auto half_rad = ReadNumber<double>(input) / 2;
  const bool is_upside_down = input.Byte() % 2 == 1;
  message.quat[is_upside_down ? 1 : 0] = std::cos(half_rad);
  message.quat[is_upside_down ? 2 : 3] = std::sin(half_rad);
  return Encode(message);
}

Message Damaged(FuzzInput& input, Message message) {
  for (const uint8_t byte : input.Bytes(4)) message[input.Byte() % message.size()] = byte;
  return message;
}

Message Raw(FuzzInput& input) {
  const absl::Span<const uint8_t> bytes = input.Bytes(input.Byte());
  return {bytes.begin(), bytes.end()};
}

// To the walls of a room of 6 x 4 m; nothing true from outside.
float RangeInRoom(const Pose2& room_T_sensor, double bearing_rad) {
  const Eigen::Vector2d& at = room_T_sensor.position_m;
  const double direction_rad = room_T_sensor.yaw_rad + bearing_rad;
  const double along_x = std::cos(direction_rad);
  const double along_y = std::sin(direction_rad);
  return static_cast<float>(std::min((std::copysign(3, along_x) - at.x()) / along_x,
                                     (std::copysign(2, along_y) - at.y()) / along_y));
}

Message ScanOfRoom(const Pose2& room_T_sensor, Utime utime, bool is_planar) {
  constexpr int kBeams = 3;
  const double step_rad = 2 * std::acos(-1.0) / kBeams;
  std::vector<float> ranges_m;
  michigan::lidar_t message{};
  message.utime = utime.count();
  for (int k = 0; k < kBeams; ++k) {
    ranges_m.push_back(RangeInRoom(room_T_sensor, k * step_rad));
    AddBeam(message, ranges_m.back(), static_cast<float>(k * step_rad),
            utime + k * milliseconds(25));
  }
  return is_planar ? Encode(PlanarLidarMessage(utime, ranges_m, 0, step_rad)) : Encode(message);
}

}  // namespace

std::vector<uint8_t> MessageOf(int64_t hash, absl::Span<const uint8_t> fields) {
  const auto fingerprint = static_cast<uint64_t>(hash);
  std::vector<uint8_t> message;
  for (int shift = 56; shift >= 0; shift -= 8) {
    message.push_back(static_cast<uint8_t>(fingerprint >> shift));
  }
  message.insert(message.end(), fields.begin(), fields.end());
  return message;
}

Utime ReadUtime(FuzzInput& input, Utime& clock) {
  const auto step = static_cast<int8_t>(input.Byte());
  if (step == -128) return Utime(input.Take<int64_t>());
  // A scan's own clock may stand at either end of time already.
  int64_t count = 0;
  if (__builtin_add_overflow(clock.count(), 10'000 * step, &count)) return clock;
  return clock = Utime(count);
}

void ReadMessage(FuzzInput& input, absl::Span<const std::string> channels, Utime& clock,
                 MessageSink sink) {
  const std::string& channel = channels[input.Byte() % channels.size()];
  const uint8_t kind = input.Byte() % 7;
  const Utime utime = ReadUtime(input, clock);
  switch (kind) {
    case 0:
      return sink(channel, Pose(input, utime));
    case 1:
      return sink(channel, MichiganPose(input, utime));
    case 2:
      return sink(channel, PlanarScan(input, utime));
    case 3:
      return sink(channel, MichiganScan(input, utime));
    case 4:
      return sink(channel, Mount(input, utime));
    case 5:
      return sink(channel, Damaged(input, MichiganScan(input, utime)));
    default:
      return sink(channel, Raw(input));
  }
}

void ReadDrive(FuzzInput& input, absl::Span<const std::string> channels, Utime& clock,
               MessageSink sink) {
  const std::string& channel = channels[input.Byte() % channels.size()];
  const uint8_t choice = input.Byte();
  const double turn_rad = 0.05 * static_cast<int8_t>(input.Byte());
  Pose2 pose;
  for (int k = 0; k < choice % 20; ++k) {
    clock += milliseconds(400);
    pose = pose * Pose2{{0.05, 0}, turn_rad};
    sink(channels.front(), Encode(PoseMessage({clock, pose})));
    sink(channel, ScanOfRoom(pose, clock, choice < 128));
  }
}

}  // namespace splinemap
