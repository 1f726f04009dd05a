#include "lib/archive/scan_record.h"

#include <algorithm>
#include <bit>
#include <memory>

#include "lib/archive/beam_limits.h"
#include "lib/archive/bearing_code.h"
#include "lib/archive/bit_stream.h"
#include "lib/archive/range_code.h"
#include "lib/archive/sensor_pose_code.h"
#include "lib/base/status.h"

namespace splinemap {
namespace {

// A record is a stream of bits, in this order: model, channel, poses of the sensor, readings, hits,
// bearings, ranges.

constexpr int kCountBits = 15;
static_assert(kMaxBeams < 1 << kCountBits);
// Of the longest codes of all that a beam has, and that a scan has besides.
constexpr size_t kMaxBytesPerBeam = 96;
constexpr size_t kMaxBytesPerScan = 256;

void PutModel(const BeamModelOptions& model, BitWriter& writer) {
  const bool is_default = model == BeamModelOptions();
  writer.PutFlag(is_default);
  if (is_default) return;
  writer.Put(static_cast<uint64_t>(model.update), 2);
  for (const double number : {model.kappa_hit, model.kappa_free, model.free_sample_spacing_knots}) {
    const auto bits = std::bit_cast<uint64_t>(number);
    writer.Put(bits & 0xffffffff, 32);
    writer.Put(bits >> 32, 32);
  }
}

BeamModelOptions TakeModel(BitReader& reader) {
  BeamModelOptions model;
  if (reader.TakeFlag()) return model;
  model.update = static_cast<BeamUpdate>(reader.Take(2));
  for (double* number : {&model.kappa_hit, &model.kappa_free, &model.free_sample_spacing_knots}) {
    const uint64_t low = reader.Take(32);
    *number = std::bit_cast<double>(reader.Take(32) << 32 | low);
  }
  return model;
}

// Runs of numbers that count up, and the step to the next run, modulo 2^16: beams of any order can
// be.
void PutReadings(const std::vector<Beam>& beams, BitWriter& writer) {
  RiceContext runs{.last = 64, .before_last = 64}, steps;
  uint16_t next = 0;
  size_t begin = 0;
  for (size_t k = 0; k < beams.size(); ++k, ++next) {
    if (beams[k].reading == next) continue;
    writer.PutFlag(true);
    writer.PutRice(k - begin, runs);
    writer.PutRice(static_cast<uint16_t>(beams[k].reading - next), steps);
    begin = k;
    next = beams[k].reading;
  }
  writer.PutFlag(false);
}

bool TakeReadings(BitReader& reader, std::vector<Beam>& beams) {
  RiceContext runs{.last = 64, .before_last = 64}, steps;
  uint16_t next = 0;
  size_t k = 0;
  while (reader.TakeFlag()) {
    const uint64_t run = reader.TakeRice(runs);
    if (run > beams.size() - k) return false;
    for (const size_t end = k + run; k < end; ++k, ++next) beams[k].reading = next;
    next = static_cast<uint16_t>(next + reader.TakeRice(steps));
  }
  for (; k < beams.size(); ++k, ++next) beams[k].reading = next;
  return true;
}

// Runs with and without, in turn.
void PutHits(const std::vector<Beam>& beams, BitWriter& writer) {
  const bool all_hit =
      std::all_of(beams.begin(), beams.end(), [](const Beam& beam) { return beam.hit; });
  writer.PutFlag(all_hit);
  if (all_hit) return;
  RiceContext runs[2];
  bool hit = true;
  for (auto begin = beams.begin(); begin != beams.end(); hit = !hit) {
    const auto end = std::find_if(begin, beams.end(), [&](const Beam& b) { return b.hit != hit; });
    writer.PutRice(static_cast<uint64_t>(end - begin), runs[hit ? 1 : 0]);
    begin = end;
  }
}

bool TakeHits(BitReader& reader, std::vector<Beam>& beams) {
  if (reader.TakeFlag()) return true;  // as beams are made
  RiceContext runs[2];
  bool hit = true;
  for (size_t k = 0; k < beams.size(); hit = !hit) {
    const uint64_t run = reader.TakeRice(runs[hit ? 1 : 0]);
    if (run > beams.size() - k || (run == 0 && k > 0)) return false;
    for (const size_t end = k + run; k < end; ++k) beams[k].hit = hit;
  }
  return true;
}

}  // namespace

std::string PackBeams(const PosedScan& scan, const BeamModelOptions& model) {
  const size_t count = scan.beams.size();
  const auto bytes =
      std::make_unique_for_overwrite<uint8_t[]>(kMaxBytesPerScan + kMaxBytesPerBeam * count);
  BitWriter writer(bytes.get());
  PutModel(model, writer);
  writer.PutNumber(static_cast<uint64_t>(scan.channel));
  writer.Put(count, kCountBits);
  const bool has_poses = scan.robot_T_sensor.size() != 1;
  writer.PutFlag(has_poses);
  PutSensorPoses(scan.robot_T_sensor, writer);
  if (count > 0) {
    PutReadings(scan.beams, writer);
    PutHits(scan.beams, writer);
    PutBearings(scan.beams, writer);
    PutRanges(scan.beams, writer);
  }
  return std::string(reinterpret_cast<const char*>(bytes.get()), writer.size());
}

absl::StatusOr<UnpackedBeams> UnpackBeams(absl::Span<const uint8_t> record) {
  BitReader reader(record);
  UnpackedBeams unpacked;
  PosedScan& scan = unpacked.scan;
  unpacked.model = TakeModel(reader);
  const uint64_t channel = reader.TakeNumber();
  const size_t count = reader.Take(kCountBits);
  // A beam takes a bit at least: what is cut off or made up is refused before memory is allocated.
  bool can_be = CanBe(unpacked.model) && channel <= kMaxChannel &&
                count <= static_cast<size_t>(kMaxBeams) &&
                static_cast<int64_t>(count) <= reader.bits_left();
  if (can_be) {
    scan.channel = static_cast<int>(channel);
    can_be = TakeSensorPoses(reader.TakeFlag() ? count : 1, reader, scan.robot_T_sensor);
  }
  if (can_be && count > 0) {
    scan.beams.resize(count);
    can_be = TakeReadings(reader, scan.beams) && TakeHits(reader, scan.beams) &&
             TakeBearings(reader, scan.beams) && TakeRanges(reader, scan.beams);
  }
  const int64_t rest = reader.bits_left();
  if (!can_be || rest < 0 || rest >= 8 || reader.Take(static_cast<int>(rest)) != 0) {
    return DataLoss("beams that cannot be");
  }
  return unpacked;
}

}  // namespace splinemap
