#include <algorithm>
#include <optional>
#include <utility>

#include "lib/archive/archive.pb.h"
#include "lib/archive/earlier_block.h"
#include "lib/archive/scan_record.h"
#include "lib/base/status.h"
#include "lib/geometry/binary_angle.h"
#include "splinemap/scan_archive.h"

namespace splinemap {
namespace {

constexpr Utime kMaxTime{int64_t{1} << 60};  // so that differences of times are some

std::string PackPoses(absl::Span<const ScanPose> poses) {
  archive_records::PosesRecord record;
  ScanPose before;
  for (const ScanPose& pose : poses) {
    record.add_utime((pose.utime - before.utime).count());
    record.add_x(pose.world_T_robot.x - before.world_T_robot.x);
    record.add_y(pose.world_T_robot.y - before.world_T_robot.y);
    record.add_yaw(WrappedStep(before.world_T_robot.yaw, pose.world_T_robot.yaw));
    before = pose;
  }
  return record.SerializeAsString();
}

std::optional<std::vector<ScanPose>> PosesOf(const std::string& bytes) {
  archive_records::PosesRecord record;
  if (!record.ParseFromString(bytes)) return std::nullopt;
  const int count = record.utime_size();
  if (record.x_size() != count || record.y_size() != count || record.yaw_size() != count)
    return std::nullopt;
  std::vector<ScanPose> poses;
  uint64_t utime = 0, x = 0, y = 0;
  int32_t yaw = 0;
  for (int k = 0; k < count; ++k) {
    utime += static_cast<uint64_t>(record.utime(k));
    x += static_cast<uint64_t>(record.x(k));
    y += static_cast<uint64_t>(record.y(k));
    yaw = WrappedSum(yaw, record.yaw(k));
    const FixedPose2 pose{static_cast<int64_t>(x), static_cast<int64_t>(y), yaw};
    const Utime time(static_cast<int64_t>(utime));
    if (!pose.IsValid() || time < -kMaxTime || time > kMaxTime) return std::nullopt;
    poses.push_back({time, pose});
  }
  return poses;
}

struct UnpackedBlock {
  BeamModelOptions model;
  PosedScans scans;
};

std::optional<UnpackedBlock> Unpack(const std::string& beams, const std::vector<ScanPose>& poses) {
  if (IsEarlierBlock(beams)) {
    auto earlier = UnpackEarlierBlock(beams, poses);
    if (!earlier) return std::nullopt;
    return UnpackedBlock{earlier->model, std::move(earlier->scans)};
  }
  archive_records::BeamsRecord record;
  if (!record.ParseFromString(beams) || record.record_size() != static_cast<int>(poses.size())) {
    return std::nullopt;
  }
  UnpackedBlock block;
  for (size_t k = 0; k < poses.size(); ++k) {
    const std::string& bytes = record.record(static_cast<int>(k));
    auto unpacked = UnpackBeams({reinterpret_cast<const uint8_t*>(bytes.data()), bytes.size()});
    if (!unpacked.ok() || (k > 0 && unpacked->model != block.model)) return std::nullopt;
    block.model = unpacked->model;
    unpacked->scan.utime = poses[k].utime;
    unpacked->scan.world_T_robot = poses[k].world_T_robot;
    block.scans.push_back(std::make_shared<PosedScan>(std::move(unpacked->scan)));
  }
  return block;
}

}  // namespace

PackedScan Pack(const PosedScan& scan, const BeamModelOptions& model) {
  return {{scan.utime, scan.world_T_robot},
          scan.beams.size(),
          std::make_shared<const std::string>(PackBeams(scan, model))};
}

std::shared_ptr<const ScanBlock> MakeBlock(const BeamModelOptions& model,
                                           absl::Span<const PackedScan> scans) {
  auto block = std::make_shared<ScanBlock>();
  block->model = model;
  block->num_scans = static_cast<int>(scans.size());
  archive_records::BeamsRecord record;
  std::vector<ScanPose> poses;
  for (const PackedScan& scan : scans) {
    record.add_record(*scan.beams);
    poses.push_back(scan.pose);
  }
  block->poses = PackPoses(poses);
  block->beams = std::make_shared<const std::string>(record.SerializeAsString());
  return block;
}

absl::StatusOr<std::shared_ptr<const ScanBlock>> BlockOf(std::string poses, std::string beams) {
  const auto scan_poses = PosesOf(poses);
  const auto unpacked =
      scan_poses && !scan_poses->empty() ? Unpack(beams, *scan_poses) : std::nullopt;
  if (!unpacked) return DataLoss("scans that cannot be");
  auto block = std::make_shared<ScanBlock>();
  block->model = unpacked->model;
  block->num_scans = static_cast<int>(scan_poses->size());
  block->poses = std::move(poses);
  block->beams = std::make_shared<const std::string>(std::move(beams));
  return block;
}

std::vector<ScanPose> UnpackPoses(const ScanBlock& block) { return *PosesOf(block.poses); }

PosedScans UnpackScans(const ScanBlock& block) {
  return Unpack(*block.beams, UnpackPoses(block))->scans;
}

std::shared_ptr<const ScanBlock> WithPoses(const ScanBlock& block,
                                           absl::Span<const ScanPose> poses) {
  auto moved = std::make_shared<ScanBlock>(block);
  moved->poses = PackPoses(poses);
  return moved;
}

}  // namespace splinemap
