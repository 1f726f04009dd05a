#include <zstd.h>

#include <algorithm>
#include <cmath>
#include <cstring>
#include <map>
#include <optional>
#include <utility>

#include "lib/archive/archive.pb.h"
#include "lib/archive/beam_limits.h"
#include "lib/base/status.h"
#include "lib/geometry/binary_angle.h"
#include "splinemap/scan_archive.h"

namespace splinemap {
namespace {

constexpr int kZstdLevel = 1;
constexpr size_t kMaxUnpackedBytes = size_t{16} << 20;
constexpr Utime kMaxTime{int64_t{1} << 60};  // so that differences of times are some

enum Flag : uint32_t { kHasSensorPoses = 1, kHasBearings = 2, kHasHits = 4 };

constexpr int kUnitPlanes = 3;

// Adds the ranges in these units. False, and adds nothing, unless all are RangeOf() of them to the
// last bit.
bool AddInUnits(const std::vector<Beam>& beams, uint32_t unit_um, std::vector<uint32_t>& units) {
  constexpr double kLimit = 1 << (8 * kUnitPlanes);
  const double per_m = 1e6 / unit_um;
  const size_t begin = units.size();
  units.resize(begin + beams.size());
  uint32_t* const to = units.data() + begin;
  int differ = 0;
  // Without a branch, so that compilers do several at once.
  for (size_t k = 0; k < beams.size(); ++k) {
    const double number = std::min(beams[k].range_m * per_m + 0.5, kLimit);
    to[k] = static_cast<uint32_t>(static_cast<int32_t>(number));
    differ |=
        (number == kLimit) | (RangeOf(static_cast<int32_t>(to[k]), unit_um) != beams[k].range_m);
  }
  if (differ != 0) units.resize(begin);
  return differ == 0;
}

uint32_t BitsOf(float number) {
  uint32_t bits = 0;
  std::memcpy(&bits, &number, sizeof bits);
  return bits;
}

float FloatOf(uint32_t bits) {
  float number = 0;
  std::memcpy(&number, &bits, sizeof number);
  return number;
}

// The lowest bytes of all numbers, then the next.
std::string PlanesOf(const std::vector<uint32_t>& numbers, int planes) {
  const size_t count = numbers.size();
  std::string bytes(count * planes, '\0');
  for (int plane = 0; plane < planes; ++plane) {
    char* const to = bytes.data() + plane * count;
    const uint32_t* const from = numbers.data();
    const int shift = 8 * plane;
    for (size_t k = 0; k < count; ++k) to[k] = static_cast<char>(from[k] >> shift);
  }
  return bytes;
}

std::optional<std::vector<uint32_t>> NumbersOf(const std::string& bytes, int planes) {
  if (bytes.size() % planes != 0) return std::nullopt;
  const size_t count = bytes.size() / planes;
  std::vector<uint32_t> numbers(count);
  for (int plane = 0; plane < planes; ++plane) {
    for (size_t k = 0; k < count; ++k) {
      numbers[k] |= uint32_t{static_cast<uint8_t>(bytes[plane * count + k])} << 8 * plane;
    }
  }
  return numbers;
}

// The bearings of a channel by the number of the reading. Those of most scans are those of the scan
// before.
class Bearings {
 public:
  bool Know(const Beam& beam) const {
    return beam.reading < bits_.size() && bits_[beam.reading] == BitsOf(beam.bearing_rad);
  }
  void Set(const Beam& beam) {
    if (beam.reading >= bits_.size()) bits_.resize(beam.reading + size_t{1}, kUnknown);
    bits_[beam.reading] = BitsOf(beam.bearing_rad);
  }
  std::optional<float> Find(uint16_t reading) const {
    if (reading >= bits_.size() || bits_[reading] == kUnknown) return std::nullopt;
    return FloatOf(bits_[reading]);
  }

 private:
  static constexpr uint32_t kUnknown = 0xffffffff;  // a NaN
  std::vector<uint32_t> bits_;
};

archive_records::BeamModelRecord RecordOf(const BeamModelOptions& model) {
  archive_records::BeamModelRecord record;
  record.set_update(static_cast<uint32_t>(model.update));
  record.set_kappa_hit(model.kappa_hit);
  record.set_kappa_free(model.kappa_free);
  record.set_free_sample_spacing_knots(model.free_sample_spacing_knots);
  return record;
}

std::optional<BeamModelOptions> ModelOf(const archive_records::BeamModelRecord& record) {
  if (record.update() > static_cast<uint32_t>(BeamUpdate::kPaperLine)) return std::nullopt;
  const BeamModelOptions model{static_cast<BeamUpdate>(record.update()), record.kappa_hit(),
                               record.kappa_free(), record.free_sample_spacing_knots()};
  return CanBe(model) ? std::optional(model) : std::nullopt;
}

std::string Compressed(const std::string& bytes) {
  // Its tables are large, and cleared sooner than they are allocated.
  thread_local const std::unique_ptr<ZSTD_CCtx, decltype(&ZSTD_freeCCtx)> context(ZSTD_createCCtx(),
                                                                                  &ZSTD_freeCCtx);
  std::string packed(ZSTD_compressBound(bytes.size()), '\0');
  packed.resize(ZSTD_compressCCtx(context.get(), packed.data(), packed.size(), bytes.data(),
                                  bytes.size(), kZstdLevel));
  packed.shrink_to_fit();
  return packed;
}

class BeamPacker {
 public:
  void Add(const PosedScan& scan) {
    uint32_t flags = 0;
    const bool has_poses = scan.robot_T_sensor.size() != 1;
    if (has_poses) flags |= kHasSensorPoses;
    for (const FixedPose2& pose : scan.robot_T_sensor) AddSensorPose(pose);
    if (AddBearings(scan)) flags |= kHasBearings;
    AddReadings(scan.beams);
    if (AddHits(scan.beams)) flags |= kHasHits;
    AddRanges(scan.beams);
    record_.add_channel(scan.channel);
    record_.add_beams(static_cast<uint32_t>(scan.beams.size()));
    record_.add_flags(flags);
  }

  std::string Finish(const BeamModelOptions& model) {
    *record_.mutable_model() = RecordOf(model);
    record_.set_bearing_bits(PlanesOf(bearings_, 4));
    record_.set_range_bits(PlanesOf(range_bits_, 4));
    record_.set_range_units(PlanesOf(range_units_, kUnitPlanes));
    const std::string bytes = record_.SerializeAsString();
    return Compressed(bytes);
  }

 private:
  void AddSensorPose(const FixedPose2& pose) {
    record_.add_sensor_x(pose.x - sensor_.x);
    record_.add_sensor_y(pose.y - sensor_.y);
    record_.add_sensor_yaw(WrappedStep(sensor_.yaw, pose.yaw));
    sensor_ = pose;
  }

  bool AddBearings(const PosedScan& scan) {
    Bearings& known = known_bearings_[scan.channel];
    if (std::all_of(scan.beams.begin(), scan.beams.end(),
                    [&](const Beam& beam) { return known.Know(beam); })) {
      return false;
    }
    for (const Beam& beam : scan.beams) {
      bearings_.push_back(BitsOf(beam.bearing_rad));
      known.Set(beam);
    }
    return true;
  }

  void AddReadings(const std::vector<Beam>& beams) {
    auto& steps = *record_.mutable_reading_step();
    const int begin = steps.size();
    steps.Resize(begin + static_cast<int>(beams.size()), 0);
    uint32_t* const to = steps.mutable_data() + begin;
    int next = 0;
    for (size_t k = 0; k < beams.size(); ++k) {
      // Modulo 2^16: beams of any order can be.
      to[k] = static_cast<uint16_t>(beams[k].reading - next);
      next = beams[k].reading + 1;
    }
  }

  bool AddHits(const std::vector<Beam>& beams) {
    if (std::all_of(beams.begin(), beams.end(), [](const Beam& beam) { return beam.hit; }))
      return false;
    for (const Beam& beam : beams) record_.mutable_hits()->push_back(beam.hit ? 1 : 0);
    return true;
  }

  void AddRanges(const std::vector<Beam>& beams) {
    for (const uint32_t unit_um : kRangeUnits_um) {
      if (!AddInUnits(beams, unit_um, range_units_)) continue;
      record_.add_range_unit_um(unit_um);
      return;
    }
    record_.add_range_unit_um(0);
    for (const Beam& beam : beams) range_bits_.push_back(BitsOf(beam.range_m));
  }

  archive_records::BeamsRecord record_;
  FixedPose2 sensor_;
  std::map<int, Bearings> known_bearings_;  // by channel
  std::vector<uint32_t> bearings_, range_bits_, range_units_;
};

// Reads one element after the other; nothing where there is none.
template <typename Elements, typename Index = size_t>
class Reader {
 public:
  explicit Reader(const Elements& elements) : elements_(elements) {}
  bool Has(size_t count) const { return static_cast<size_t>(elements_.size()) - next_ >= count; }
  auto Next() { return elements_[static_cast<Index>(next_++)]; }
  bool IsAtEnd() const { return next_ == static_cast<size_t>(elements_.size()); }

 private:
  const Elements& elements_;
  size_t next_ = 0;
};

class BeamUnpacker {
 public:
  // Nothing where the numbers do not belong together, or cannot be.
  static std::optional<PosedScans> Unpack(const archive_records::BeamsRecord& record,
                                          const std::vector<ScanPose>& poses) {
    auto bearings = NumbersOf(record.bearing_bits(), 4);
    auto range_bits = NumbersOf(record.range_bits(), 4);
    auto range_units = NumbersOf(record.range_units(), kUnitPlanes);
    const auto scans = static_cast<int>(poses.size());
    if (!bearings || !range_bits || !range_units || record.channel_size() != scans ||
        record.beams_size() != scans || record.flags_size() != scans ||
        record.range_unit_um_size() != scans || record.sensor_x_size() != record.sensor_y_size() ||
        record.sensor_x_size() != record.sensor_yaw_size()) {
      return std::nullopt;
    }
    BeamUnpacker unpacker(record, *bearings, *range_bits, *range_units);
    PosedScans result;
    for (int k = 0; k < scans; ++k) {
      auto scan = std::make_shared<PosedScan>();
      scan->utime = poses[k].utime;
      scan->world_T_robot = poses[k].world_T_robot;
      if (!unpacker.UnpackScan(k, *scan)) return std::nullopt;
      result.push_back(std::move(scan));
    }
    return unpacker.IsAtEnd() ? std::optional(std::move(result)) : std::nullopt;
  }

 private:
  BeamUnpacker(const archive_records::BeamsRecord& record, const std::vector<uint32_t>& bearings,
               const std::vector<uint32_t>& range_bits, const std::vector<uint32_t>& range_units)
      : record_(record),
        bearings_(bearings),
        range_bits_(range_bits),
        range_units_(range_units),
        readings_(record.reading_step()),
        hits_(record.hits()) {}

  bool UnpackScan(int k, PosedScan& scan) {
    const uint32_t count = record_.beams(k);
    const uint32_t flags = record_.flags(k);
    const uint32_t unit_um = record_.range_unit_um(k);
    if (count > static_cast<uint32_t>(splinemap::kMaxBeams) || record_.channel(k) > kMaxChannel ||
        unit_um > 1'000'000) {
      return false;
    }
    scan.channel = static_cast<int>(record_.channel(k));
    const size_t poses = (flags & kHasSensorPoses) != 0 ? count : 1;
    const bool has_bearings = (flags & kHasBearings) != 0;
    const bool has_hits = (flags & kHasHits) != 0;
    if (!readings_.Has(count) || !(unit_um == 0 ? range_bits_ : range_units_).Has(count) ||
        (has_bearings && !bearings_.Has(count)) || (has_hits && !hits_.Has(count)) ||
        !UnpackSensorPoses(poses, scan)) {
      return false;
    }
    Bearings& known = known_bearings_[scan.channel];
    scan.beams.resize(count);
    uint32_t next = 0;
    for (Beam& beam : scan.beams) {
      beam.reading = static_cast<uint16_t>(next + readings_.Next());
      next = beam.reading + 1;
      beam.hit = !has_hits || hits_.Next() != 0;
      beam.range_m =
          unit_um == 0 ? FloatOf(range_bits_.Next()) : RangeOf(range_units_.Next(), unit_um);
      if (!(beam.range_m >= 0 && beam.range_m <= kMaxRange_m)) return false;
      if (has_bearings) {
        beam.bearing_rad = FloatOf(bearings_.Next());
        if (!std::isfinite(beam.bearing_rad)) return false;
        known.Set(beam);
      } else if (const auto bearing_rad = known.Find(beam.reading)) {
        beam.bearing_rad = *bearing_rad;
      } else {
        return false;
      }
    }
    return true;
  }

  bool UnpackSensorPoses(size_t count, PosedScan& scan) {
    if (static_cast<size_t>(record_.sensor_x_size()) - next_pose_ < count) return false;
    for (size_t end = next_pose_ + count; next_pose_ < end; ++next_pose_) {
      const auto k = static_cast<int>(next_pose_);
      // Sums wrap where a file is hostile.
      sensor_ = {static_cast<int64_t>(static_cast<uint64_t>(sensor_.x) +
                                      static_cast<uint64_t>(record_.sensor_x(k))),
                 static_cast<int64_t>(static_cast<uint64_t>(sensor_.y) +
                                      static_cast<uint64_t>(record_.sensor_y(k))),
                 WrappedSum(sensor_.yaw, record_.sensor_yaw(k))};
      if (!sensor_.IsValid()) return false;
      scan.robot_T_sensor.push_back(sensor_);
    }
    return true;
  }

  bool IsAtEnd() const {
    return readings_.IsAtEnd() && range_bits_.IsAtEnd() && range_units_.IsAtEnd() &&
           bearings_.IsAtEnd() && hits_.IsAtEnd() &&
           next_pose_ == static_cast<size_t>(record_.sensor_x_size());
  }

  const archive_records::BeamsRecord& record_;
  Reader<std::vector<uint32_t>> bearings_, range_bits_, range_units_;
  Reader<google::protobuf::RepeatedField<uint32_t>, int> readings_;
  Reader<std::string> hits_;
  std::map<int, Bearings> known_bearings_;
  FixedPose2 sensor_;
  size_t next_pose_ = 0;
};

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

std::optional<archive_records::BeamsRecord> BeamsOf(const std::string& packed) {
  const uint64_t size = ZSTD_getFrameContentSize(packed.data(), packed.size());
  if (size > kMaxUnpackedBytes) return std::nullopt;  // also where it is not said
  std::string bytes(size, '\0');
  const size_t unpacked = ZSTD_decompress(bytes.data(), bytes.size(), packed.data(), packed.size());
  archive_records::BeamsRecord record;
  if (ZSTD_isError(unpacked) || unpacked != size || !record.ParseFromString(bytes))
    return std::nullopt;
  return record;
}

}  // namespace

std::shared_ptr<const ScanBlock> PackScans(
    const BeamModelOptions& model, absl::Span<const std::shared_ptr<const PosedScan>> scans) {
  auto block = std::make_shared<ScanBlock>();
  block->model = model;
  block->num_scans = static_cast<int>(scans.size());
  BeamPacker packer;
  std::vector<ScanPose> poses;
  for (const auto& scan : scans) {
    packer.Add(*scan);
    poses.push_back({scan->utime, scan->world_T_robot});
  }
  block->poses = PackPoses(poses);
  block->beams = std::make_shared<const std::string>(packer.Finish(model));
  return block;
}

absl::StatusOr<std::shared_ptr<const ScanBlock>> BlockOf(std::string poses, std::string beams) {
  const auto scan_poses = PosesOf(poses);
  const auto record = BeamsOf(beams);
  const auto model = record ? ModelOf(record->model()) : std::nullopt;
  if (!scan_poses || scan_poses->empty() || !model || !BeamUnpacker::Unpack(*record, *scan_poses)) {
    return DataLoss("scans that cannot be");
  }
  auto block = std::make_shared<ScanBlock>();
  block->model = *model;
  block->num_scans = static_cast<int>(scan_poses->size());
  block->poses = std::move(poses);
  block->beams = std::make_shared<const std::string>(std::move(beams));
  return block;
}

std::vector<ScanPose> UnpackPoses(const ScanBlock& block) { return *PosesOf(block.poses); }

PosedScans UnpackScans(const ScanBlock& block) {
  return *BeamUnpacker::Unpack(*BeamsOf(*block.beams), UnpackPoses(block));
}

std::shared_ptr<const ScanBlock> WithPoses(const ScanBlock& block,
                                           absl::Span<const ScanPose> poses) {
  auto moved = std::make_shared<ScanBlock>(block);
  moved->poses = PackPoses(poses);
  return moved;
}

}  // namespace splinemap
