#include "lib/archive/earlier_block.h"

#include <zstd.h>

#include <bit>
#include <cmath>
#include <map>
#include <utility>

#include "lib/archive/archive.pb.h"
#include "lib/archive/beam_limits.h"
#include "lib/geometry/binary_angle.h"

namespace splinemap {
namespace {

constexpr size_t kMaxUnpackedBytes = size_t{16} << 20;

enum Flag : uint32_t { kHasSensorPoses = 1, kHasBearings = 2, kHasHits = 4 };

constexpr int kUnitPlanes = 3;

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
  void Set(const Beam& beam) {
    if (beam.reading >= bits_.size()) bits_.resize(beam.reading + size_t{1}, kUnknown);
    bits_[beam.reading] = std::bit_cast<uint32_t>(beam.bearing_rad);
  }
  std::optional<float> Find(uint16_t reading) const {
    if (reading >= bits_.size() || bits_[reading] == kUnknown) return std::nullopt;
    return std::bit_cast<float>(bits_[reading]);
  }

 private:
  static constexpr uint32_t kUnknown = 0xffffffff;  // a NaN
  std::vector<uint32_t> bits_;
};

std::optional<BeamModelOptions> ModelOf(const archive_records::BeamModelRecord& record) {
  if (record.update() > static_cast<uint32_t>(BeamUpdate::kPaperLine)) return std::nullopt;
  const BeamModelOptions model{static_cast<BeamUpdate>(record.update()), record.kappa_hit(),
                               record.kappa_free(), record.free_sample_spacing_knots()};
  return CanBe(model) ? std::optional(model) : std::nullopt;
}

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
      beam.range_m = unit_um == 0 ? std::bit_cast<float>(range_bits_.Next())
                                  : RangeOf(range_units_.Next(), unit_um);
      if (!(beam.range_m >= 0 && beam.range_m <= kMaxRange_m)) return false;
      if (has_bearings) {
        beam.bearing_rad = std::bit_cast<float>(bearings_.Next());
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

bool IsEarlierBlock(const std::string& beams) {
  return beams.starts_with("\x28\xb5\x2f\xfd");  // zstd's
}

std::optional<EarlierBlock> UnpackEarlierBlock(const std::string& beams,
                                               const std::vector<ScanPose>& poses) {
  const auto record = BeamsOf(beams);
  const auto model = record ? ModelOf(record->model()) : std::nullopt;
  if (!model) return std::nullopt;
  auto scans = BeamUnpacker::Unpack(*record, poses);
  if (!scans) return std::nullopt;
  return EarlierBlock{*model, *std::move(scans)};
}

}  // namespace splinemap
