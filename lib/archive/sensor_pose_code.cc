#include "lib/archive/sensor_pose_code.h"

#include <algorithm>
#include <array>
#include <cstdint>

#include "lib/geometry/angle.h"
#include "lib/geometry/binary_angle.h"

namespace splinemap {
namespace {

// Numbers that were seen last, those seen just now first.
class RecentSteps {
 public:
  static constexpr size_t kSize = 32;

  // kSize where it is not there.
  size_t Find(int32_t step) const {
    return static_cast<size_t>(std::find(steps_.begin(), steps_.end(), step) - steps_.begin());
  }
  int32_t operator[](size_t index) const { return steps_[index]; }
  // Moves the step at `index` to the front; a new one where that is kSize.
  void MoveToFront(size_t index, int32_t step) {
    for (size_t k = std::min(index, kSize - 1); k > 0; --k) steps_[k] = steps_[k - 1];
    steps_[0] = step;
  }

 private:
  std::array<int32_t, kSize> steps_{};
};

// Steps of the heading. Times of beams are whole microseconds, and mostly as far apart as others
// were: so are headings.
struct YawCode {
  RecentSteps recent;
  RiceContext index;
  RiceContext new_step{.noise_bits = 10};  // of units of which a turn has 2^32
};

// What x and y of a sensor are likely to be: they go on evenly, and the heading tells how far. So
// the way from the first pose is that to the one before, as much longer as the turn is.
struct SensorPosition {
  int64_t x, y;
};
SensorPosition PredictPosition(const std::vector<FixedPose2>& poses, size_t k) {
  const FixedPose2& first = poses[0];
  const FixedPose2& last = poses[k - 1];
  const int32_t turn = WrappedStep(first.yaw, last.yaw);
  if (turn == 0) {
    const FixedPose2& before = poses[k > 1 ? k - 2 : 0];
    return {2 * last.x - before.x, 2 * last.y - before.y};
  }
  const double longer = double{1} * WrappedStep(first.yaw, poses[k].yaw) / turn;
  const auto along = [&](int64_t from, int64_t to) {
    constexpr double kLimit = 2 * FixedPose2::kMaxUnits;
    return from + RoundToInt(std::clamp(static_cast<double>(to - from) * longer, -kLimit, kLimit));
  };
  return {along(first.x, last.x), along(first.y, last.y)};
}

// Modulo 2^64 where bytes are hostile.
int64_t Sum(int64_t predicted, uint64_t residual) {
  return static_cast<int64_t>(static_cast<uint64_t>(predicted) +
                              static_cast<uint64_t>(Unzigzag(residual)));
}

}  // namespace

void PutSensorPoses(const std::vector<FixedPose2>& poses, BitWriter& writer) {
  if (poses.empty()) return;
  for (const int64_t number : {poses[0].x, poses[0].y, int64_t{poses[0].yaw}}) {
    writer.PutNumber(Zigzag(number));
  }
  YawCode yaws;
  std::vector<uint64_t> xs, ys;
  for (size_t k = 1; k < poses.size(); ++k) {
    const int32_t step = WrappedStep(poses[k - 1].yaw, poses[k].yaw);
    const size_t index = yaws.recent.Find(step);
    writer.PutRice(index, yaws.index);
    if (index == RecentSteps::kSize) {
      writer.PutRice(Zigzag(WrappedStep(yaws.recent[0], step)), yaws.new_step);
    }
    yaws.recent.MoveToFront(index, step);
    const SensorPosition predicted = PredictPosition(poses, k);
    xs.push_back(Zigzag(poses[k].x - predicted.x));
    ys.push_back(Zigzag(poses[k].y - predicted.y));
  }
  writer.PutAll(xs, {});
  writer.PutAll(ys, {});
}

bool TakeSensorPoses(size_t count, BitReader& reader, std::vector<FixedPose2>& poses) {
  if (count == 0) return true;
  poses.resize(count);
  poses[0].x = Unzigzag(reader.TakeNumber());
  poses[0].y = Unzigzag(reader.TakeNumber());
  poses[0].yaw = static_cast<int32_t>(Unzigzag(reader.TakeNumber()));
  if (!poses[0].IsValid()) return false;
  YawCode yaws;
  for (size_t k = 1; k < count; ++k) {
    const size_t index = reader.TakeRice(yaws.index);
    if (index > RecentSteps::kSize) return false;
    const auto of_new = [&] {
      return WrappedSum(yaws.recent[0],
                        static_cast<int32_t>(Unzigzag(reader.TakeRice(yaws.new_step))));
    };
    const int32_t step = index < RecentSteps::kSize ? yaws.recent[index] : of_new();
    yaws.recent.MoveToFront(index, step);
    poses[k].yaw = WrappedSum(poses[k - 1].yaw, step);
  }
  std::vector<uint64_t> xs(count), ys(count);  // of the first: 0
  reader.TakeAll(absl::MakeSpan(xs).subspan(1), {});
  reader.TakeAll(absl::MakeSpan(ys).subspan(1), {});
  for (size_t k = 1; k < count; ++k) {
    const SensorPosition predicted = PredictPosition(poses, k);
    poses[k].x = Sum(predicted.x, xs[k]);
    poses[k].y = Sum(predicted.y, ys[k]);
    if (!poses[k].IsValid()) return false;
  }
  return true;
}

}  // namespace splinemap
