#include "lib/logs/trajectory_file.h"

#include <cctype>
#include <cmath>
#include <optional>

#include "absl/strings/numbers.h"
#include "absl/strings/str_split.h"
#include "lib/base/status.h"
#include "lib/logs/carmen_log.h"
#include "lib/logs/gz_file.h"

namespace splinemap {
namespace {

// Lines of a CARMEN log begin with the name of a message, PARAM or a comment.
bool IsCarmen(const std::string& line) {
  for (const char* name : {"FLASER", "ROBOTLASER", "RAWLASER", "ODOM", "PARAM", "#"}) {
    if (line.starts_with(name)) return true;
  }
  return false;
}

absl::StatusOr<std::vector<TrajectoryPose>> ReadCarmenTrajectory(const std::string& path,
                                                                 double rate_hz) {
  SPLINEMAP_ASSIGN_OR_RETURN(const CarmenLog log, ReadCarmenLog(path, std::nullopt, [](double) {}));
  const std::vector<Utime> utimes = RepairTimes(log.scans, rate_hz).utimes;
  std::vector<TrajectoryPose> poses;
  for (size_t k = 0; k < log.scans.size(); ++k) {
    // By way of a quaternion, as in a log of messages.
    Pose2 pose = log.scans[k].world_T_laser;
    const double half_rad = pose.yaw_rad / 2;
    pose.yaw_rad = YawOfQuaternion(std::cos(half_rad), 0, 0, std::sin(half_rad));
    poses.push_back({utimes[k], pose});
  }
  return poses;
}

}  // namespace

absl::StatusOr<std::vector<TrajectoryPose>> ReadTrajectory(const std::string& path,
                                                           double rate_hz) {
  SPLINEMAP_ASSIGN_OR_RETURN(GzFile file, GzFile::Open(path));
  std::vector<TrajectoryPose> poses;
  std::string line;
  for (int64_t number = 1; file.ReadLine(line); ++number) {
    if (number == 1 && IsCarmen(line)) return ReadCarmenTrajectory(path, rate_hz);
    const bool is_header = number == 1 && !line.empty() && std::isalpha(line[0]) != 0;
    if (is_header || line.empty()) continue;
    const std::vector<std::string> words = absl::StrSplit(line, ',');
    int64_t utime = 0;
    double x = 0, y = 0, yaw = 0;
    if (words.size() != 4 || !absl::SimpleAtoi(words[0], &utime) ||
        !absl::SimpleAtod(words[1], &x) || !absl::SimpleAtod(words[2], &y) ||
        !absl::SimpleAtod(words[3], &yaw) ||
        !(std::isfinite(x) && std::isfinite(y) && std::isfinite(yaw))) {
      return InvalidArgument("{}, line {}: utime,x_m,y_m,yaw_rad is expected", path, number);
    }
    poses.push_back({Utime(utime), {{x, y}, yaw}});
  }
  SPLINEMAP_RETURN_IF_ERROR(file.status());
  return poses;
}

}  // namespace splinemap
