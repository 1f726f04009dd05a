#include "lib/archive/bearing_code.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstdint>
#include <limits>
#include <numbers>
#include <optional>

#include "lib/geometry/angle.h"

namespace splinemap {
namespace {

bool HasBitsOf(float a, float b) {
  return std::bit_cast<uint32_t>(a) == std::bit_cast<uint32_t>(b);
}

// Floats as whole numbers in their order, so that neighbours differ by 1.
uint32_t OrderOf(float number) {
  const auto bits = std::bit_cast<uint32_t>(number);
  return bits ^ (bits >> 31 != 0 ? 0x7fffffff : 0);
}
float FloatOfOrder(uint32_t order) {
  return std::bit_cast<float>(order ^ (order >> 31 != 0 ? 0x7fffffff : 0));
}

enum class BearingKind { kLine, k64thsOfDegree, kThousandthsOfDegree, kFloats };
constexpr int kBearingKindBits = 2;

// Bearings at equal steps as messages say them: first and step are floats, their sum a double.
struct BearingLine {
  float at_zero_rad = 0;  // of reading 0
  float step_rad = 0;     // of a reading

  float At(uint16_t reading) const {
    return static_cast<float>(double{at_zero_rad} + double{1} * reading * step_rad);
  }
  bool Has(const Beam& beam) const { return HasBitsOf(beam.bearing_rad, At(beam.reading)); }
  bool HasAll(const std::vector<Beam>& beams) const {
    uint32_t differ = 0;
    for (const Beam& beam : beams) {
      // Without a branch, which takes longer.
      differ |=
          std::bit_cast<uint32_t>(At(beam.reading)) ^ std::bit_cast<uint32_t>(beam.bearing_rad);
    }
    return differ == 0;
  }
  // Whether it may be read: beyond, doubles might not fit into floats.
  bool IsSmall() const {
    constexpr float kLimit_rad = 1e6;
    return std::abs(at_zero_rad) <= kLimit_rad && std::abs(step_rad) <= kLimit_rad;
  }
};

constexpr double kMaxStep_rad = 10;

// Of a reading, in the middle of a scan, since some begin with the end of the turn before.
double MeanStep(const std::vector<Beam>& beams) {
  const Beam& from = beams[beams.size() / 4];
  const Beam& to = beams[beams.size() - 1 - beams.size() / 4];
  const int readings = to.reading - from.reading;
  const double step_rad =
      readings == 0 ? 0 : (double{to.bearing_rad} - double{from.bearing_rad}) / readings;
  return std::abs(step_rad) < kMaxStep_rad ? step_rad : 0;
}

float Neighbour(float number, int away) {
  return FloatOfOrder(OrderOf(number) + static_cast<uint32_t>(away));
}

// The line that all bearings lie on, to the last bit, if it is found: rounding hides some bits of
// it.
std::optional<BearingLine> FindLine(const std::vector<Beam>& beams) {
  const Beam& first = beams.front();
  const Beam& last = beams.back();
  const int readings = last.reading - first.reading;
  const double step_rad =
      readings == 0 ? 0 : (double{last.bearing_rad} - double{first.bearing_rad}) / readings;
  const auto nearest_rad = static_cast<float>(double{first.bearing_rad} - first.reading * step_rad);
  const Beam* const samples[] = {&beams[beams.size() / 2], &beams[beams.size() / 4], &last};
  for (const int step_away : {0, 1, -1, 2, -2}) {
    for (const int zero_away : {0, 1, -1, 2, -2}) {
      if (first.reading == 0 && zero_away != 0) continue;
      const BearingLine line{
          first.reading == 0 ? first.bearing_rad : Neighbour(nearest_rad, zero_away),
          Neighbour(static_cast<float>(step_rad), step_away)};
      const bool has_samples = std::all_of(std::begin(samples), std::end(samples),
                                           [&](const Beam* beam) { return line.Has(*beam); });
      if (has_samples && line.IsSmall() && line.HasAll(beams)) return line;
    }
  }
  return std::nullopt;
}

double UnitOf(BearingKind kind) {
  // RPLidars measure in 1/64 degrees, which their drivers multiply with a float.
  if (kind == BearingKind::k64thsOfDegree)
    return double{static_cast<float>(std::numbers::pi / 180)} / 64;
  return std::numbers::pi / 180'000;
}
constexpr double kMaxBearingUnits = 1 << 30;

float BearingOf(int32_t units, double unit_rad) { return static_cast<float>(units * unit_rad); }

// All bearings in these units; nothing unless they are those to the last bit.
std::optional<std::vector<int32_t>> BearingsIn(double unit_rad, const std::vector<Beam>& beams) {
  std::vector<int32_t> numbers;
  for (const Beam& beam : beams) {
    const double number = beam.bearing_rad * (1 / unit_rad);
    if (!(std::abs(number) < kMaxBearingUnits)) return std::nullopt;
    const auto units = static_cast<int32_t>(RoundToInt(number));
    if (!HasBitsOf(beam.bearing_rad, BearingOf(units, unit_rad))) return std::nullopt;
    if (numbers.empty()) numbers.reserve(beams.size());
    numbers.push_back(units);
  }
  return numbers;
}

// Wraps where bytes are hostile.
uint32_t PredictUnits(uint32_t units, int32_t step, int readings) {
  return units + static_cast<uint32_t>(step) * static_cast<uint32_t>(readings);
}
uint32_t PredictFloat(float bearing_rad, float step_rad, int readings) {
  constexpr double kLimit = std::numeric_limits<float>::max();
  const double next_rad = double{bearing_rad} + double{step_rad} * readings;
  return OrderOf(static_cast<float>(std::clamp(next_rad, -kLimit, kLimit)));
}

void PutKind(BearingKind kind, BitWriter& writer) {
  writer.Put(static_cast<uint64_t>(kind), kBearingKindBits);
}

bool PutBearingUnits(const std::vector<Beam>& beams, BitWriter& writer) {
  const double mean_step_rad = MeanStep(beams);
  const bool is_clockwise = mean_step_rad < 0;  // then 0 is -0, too
  for (const BearingKind kind : {BearingKind::k64thsOfDegree, BearingKind::kThousandthsOfDegree}) {
    const double unit_rad = (is_clockwise ? -1 : 1) * UnitOf(kind);
    const auto units = BearingsIn(unit_rad, beams);
    if (!units) continue;
    PutKind(kind, writer);
    writer.PutFlag(is_clockwise);
    const auto step = static_cast<int32_t>(RoundToInt(mean_step_rad / unit_rad));
    writer.PutNumber(Zigzag(step));
    RiceContext context;
    uint32_t last = 0;
    int reading = 0;
    for (size_t k = 0; k < beams.size(); ++k) {
      const uint32_t predicted = PredictUnits(last, step, beams[k].reading - reading);
      last = static_cast<uint32_t>((*units)[k]);
      reading = beams[k].reading;
      writer.PutRice(ZigzagStep(predicted, last), context);
    }
    return true;
  }
  return false;
}

bool TakeBearingUnits(BearingKind kind, BitReader& reader, std::vector<Beam>& beams) {
  const double unit_rad = (reader.TakeFlag() ? -1 : 1) * UnitOf(kind);
  const auto step = static_cast<int32_t>(Unzigzag(reader.TakeNumber()));
  RiceContext context;
  uint32_t last = 0;
  int reading = 0;
  for (Beam& beam : beams) {
    last = Stepped(PredictUnits(last, step, beam.reading - reading), reader.TakeRice(context));
    reading = beam.reading;
    beam.bearing_rad = BearingOf(static_cast<int32_t>(last), unit_rad);
  }
  return true;
}

bool TakeLine(BitReader& reader, std::vector<Beam>& beams) {
  BearingLine line;
  line.at_zero_rad = reader.TakeFloat();
  line.step_rad = reader.TakeFloat();
  if (!line.IsSmall()) return false;
  for (Beam& beam : beams) beam.bearing_rad = line.At(beam.reading);
  return true;
}

}  // namespace

void PutBearings(const std::vector<Beam>& beams, BitWriter& writer) {
  if (const auto line = FindLine(beams)) {
    PutKind(BearingKind::kLine, writer);
    writer.PutFloat(line->at_zero_rad);
    writer.PutFloat(line->step_rad);
    return;
  }
  if (PutBearingUnits(beams, writer)) return;
  PutKind(BearingKind::kFloats, writer);
  const auto step_rad = static_cast<float>(MeanStep(beams));
  writer.PutFloat(step_rad);
  RiceContext context;
  Beam last;
  for (const Beam& beam : beams) {
    writer.PutRice(ZigzagStep(PredictFloat(last.bearing_rad, step_rad, beam.reading - last.reading),
                              OrderOf(beam.bearing_rad)),
                   context);
    last = beam;
  }
}

bool TakeBearings(BitReader& reader, std::vector<Beam>& beams) {
  const auto kind = static_cast<BearingKind>(reader.Take(kBearingKindBits));
  if (kind == BearingKind::kLine) return TakeLine(reader, beams);
  if (kind != BearingKind::kFloats) return TakeBearingUnits(kind, reader, beams);
  const auto step_rad = reader.TakeFloat();
  if (!std::isfinite(step_rad)) return false;
  RiceContext context;
  Beam last;
  for (Beam& beam : beams) {
    beam.bearing_rad =
        FloatOfOrder(Stepped(PredictFloat(last.bearing_rad, step_rad, beam.reading - last.reading),
                             reader.TakeRice(context)));
    if (!std::isfinite(beam.bearing_rad)) return false;
    last = beam;
  }
  return true;
}

}  // namespace splinemap
