// What `splinemap build` is compared with: maps an LCM log into MRPT's grid and ends.
#include <mrpt/maps/COccupancyGridMap2D.h>
#include <mrpt/obs/CObservation2DRangeScan.h>

#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <deque>
#include <optional>
#include <vector>

#include "lcm/lcm-cpp.hpp"
#include "lcmtypes/bot_core/planar_lidar_t.hpp"
#include "lcmtypes/bot_core/pose_t.hpp"

namespace {

constexpr float kCell_m = 0.05F;
constexpr float kRangeMax_m = 30;

struct Pose {
  int64_t utime = 0;
  double x_m = 0;
  double y_m = 0;
  double yaw_rad = 0;
};

Pose PoseOf(const bot_core::pose_t& message) {
  const double* q = message.orientation;
  return {message.utime, message.pos[0], message.pos[1],
          std::atan2(2 * (q[0] * q[3] + q[1] * q[2]), 1 - 2 * (q[2] * q[2] + q[3] * q[3]))};
}

Pose Interpolate(const Pose& before, const Pose& after, int64_t utime) {
  const double span = static_cast<double>(after.utime - before.utime);
  const double share = static_cast<double>(utime - before.utime) / span;
  const double turn_rad = std::remainder(after.yaw_rad - before.yaw_rad, 2 * M_PI);
  return {utime, before.x_m + share * (after.x_m - before.x_m),
          before.y_m + share * (after.y_m - before.y_m), before.yaw_rad + share * turn_rad};
}

class GridBuilder {
 public:
  GridBuilder(float x_min_m, float x_max_m, float y_min_m, float y_max_m)
      : map_(x_min_m, x_max_m, y_min_m, y_max_m, kCell_m) {
    map_.insertionOptions.maxDistanceInsertion = kRangeMax_m;
    map_.insertionOptions.considerInvalidRangesAsFreeSpace = false;
    map_.insertionOptions.wideningBeamsWithDistance = false;
  }

  void Handle(const lcm::LogEvent& event) {
    if (event.channel == "POSE" && pose_.decode(event.data, 0, event.datalen) >= 0) {
      before_ = after_;
      after_ = PoseOf(pose_);
      InsertWaiting();
    } else if (event.channel == "LASER") {
      waiting_.emplace_back();
      if (waiting_.back().decode(event.data, 0, event.datalen) < 0) waiting_.pop_back();
      InsertWaiting();
    }
  }

  int inserted() const { return inserted_; }

 private:
  void InsertWaiting() {
    while (!waiting_.empty() && after_ && after_->utime >= waiting_.front().utime) {
      const int64_t utime = waiting_.front().utime;
      if (after_->utime == utime) {
        Insert(waiting_.front(), *after_);
      } else if (before_ && before_->utime <= utime) {
        Insert(waiting_.front(), Interpolate(*before_, *after_, utime));
      }
      waiting_.pop_front();
    }
  }

  // MRPT's scans are symmetric to the sensor's x axis, so that the pose has to turn.
  void Insert(const bot_core::planar_lidar_t& scan, const Pose& pose) {
    valid_.resize(scan.ranges.size());
    for (size_t k = 0; k < valid_.size(); ++k) {
      valid_[k] = scan.ranges[k] > 0 && scan.ranges[k] < kRangeMax_m ? 1 : 0;
    }
    observation_.loadFromVectors(valid_.size(), scan.ranges.data(), valid_.data());
    const float aperture_rad = static_cast<float>(valid_.size() - 1) * scan.radstep;
    observation_.aperture = aperture_rad;
    observation_.maxRange = kRangeMax_m;
    const double middle_rad = pose.yaw_rad + double{scan.rad0 + aperture_rad / 2};
    map_.insertObservation(observation_,
                           mrpt::poses::CPose3D(pose.x_m, pose.y_m, 0, middle_rad, 0, 0));
    ++inserted_;
  }

  mrpt::maps::COccupancyGridMap2D map_;
  mrpt::obs::CObservation2DRangeScan observation_;
  std::vector<char> valid_;
  bot_core::pose_t pose_;
  std::deque<bot_core::planar_lidar_t> waiting_;
  std::optional<Pose> before_, after_;
  int inserted_ = 0;
};

}  // namespace

int main(int argc, char** argv) {
  if (argc != 6) {
    std::fputs("usage: mrpt_build LOG X_MIN_M X_MAX_M Y_MIN_M Y_MAX_M\n", stderr);
    return 2;
  }
  lcm::LogFile log(argv[1], "r");
  if (!log.good()) return 1;
  GridBuilder grid(std::strtof(argv[2], nullptr), std::strtof(argv[3], nullptr),
                   std::strtof(argv[4], nullptr), std::strtof(argv[5], nullptr));
  while (const lcm::LogEvent* event = log.readNextEvent()) grid.Handle(*event);
  std::printf("%d scans\n", grid.inserted());
  return grid.inserted() > 0 ? 0 : 1;
}
