#include "lib/archive/range_code.h"

#include <algorithm>
#include <bit>
#include <cstdint>
#include <utility>

#include "lib/archive/beam_limits.h"

namespace splinemap {
namespace {

constexpr int kUnitBits = 2;
constexpr int kNumRangeUnits = std::size(kRangeUnits_um);  // this one: floats
static_assert(kNumRangeUnits < 1 << kUnitBits);

// Sets `numbers` to the ranges in these units. False unless they are RangeOf() of them to the last
// bit.
bool RangesIn(uint32_t unit_um, const std::vector<Beam>& beams, uint32_t* numbers) {
  constexpr float kLimit = 1 << 24;
  const auto per_m = static_cast<float>(1e6 / unit_um);
  const auto convert = [&](size_t begin, size_t end) {
    uint32_t differ = 0;
    // Without a branch, so that compilers do several at once.
    for (size_t k = begin; k < end; ++k) {
      const float range_m = beams[k].range_m;
      const auto units = static_cast<int32_t>(std::min(kLimit, range_m * per_m + 0.5F));
      numbers[k] = static_cast<uint32_t>(units);
      differ |= std::bit_cast<uint32_t>(RangeOf(units, unit_um)) ^ std::bit_cast<uint32_t>(range_m);
    }
    return differ == 0;
  };
  // Most scanners that measure otherwise show it soon.
  const size_t few = std::min<size_t>(beams.size(), 8);
  return convert(0, few) && convert(few, beams.size());
}

// The index of the units.
int ChooseUnits(const std::vector<Beam>& beams, uint32_t* numbers) {
  for (int unit = 0; unit < kNumRangeUnits; ++unit) {
    if (RangesIn(kRangeUnits_um[unit], beams, numbers)) return unit;
  }
  for (size_t k = 0; k < beams.size(); ++k) numbers[k] = std::bit_cast<uint32_t>(beams[k].range_m);
  return kNumRangeUnits;
}

// What a range is likely to be after the two before it, modulo 2^32: the same where ranges are
// coarse or noisy, else on a line.
uint32_t PredictRange(bool on_line, uint32_t last, uint32_t before_last) {
  return on_line ? 2 * last - before_last : last;
}

// How ranges of a scan are packed.
struct RangeCode {
  bool on_line = false;
  int noise_bits = 0;
};
constexpr int kNoiseBits = 5;

// The first range stands twice before the others.
constexpr size_t kBefore = 2;

uint64_t Residual(bool on_line, const std::vector<uint32_t>& numbers, size_t k) {
  return ZigzagStep(PredictRange(on_line, numbers[k - 1], numbers[k - 2]), numbers[k]);
}

// By the digits of some residuals.
RangeCode ChooseCode(const std::vector<uint32_t>& numbers) {
  constexpr size_t kEvery = 4;
  int digits[] = {0, 0};
  int samples = 1;
  for (size_t k = kBefore; k < numbers.size(); k += kEvery, ++samples) {
    for (const bool on_line : {false, true}) {
      digits[on_line ? 1 : 0] += NumDigits(Residual(on_line, numbers, k));
    }
  }
  const bool on_line = digits[1] < digits[0];
  return {on_line, std::clamp(digits[on_line ? 1 : 0] / samples - 4, 0, 31)};
}

}  // namespace

void PutRanges(const std::vector<Beam>& beams, BitWriter& writer) {
  std::vector<uint32_t> numbers(kBefore - 1 + beams.size());
  const int units = ChooseUnits(beams, numbers.data() + kBefore - 1);
  numbers[0] = numbers[1];
  const RangeCode code = ChooseCode(numbers);
  writer.Put(static_cast<uint64_t>(units), kUnitBits);
  writer.PutFlag(code.on_line);
  writer.Put(static_cast<uint64_t>(code.noise_bits), kNoiseBits);
  writer.PutNumber(numbers[0]);
  std::vector<uint64_t> residuals(beams.size() - 1);
  for (size_t k = 0; k < residuals.size(); ++k) {
    residuals[k] = Residual(code.on_line, numbers, kBefore + k);
  }
  writer.PutAll(residuals, {.noise_bits = code.noise_bits});
}

bool TakeRanges(BitReader& reader, std::vector<Beam>& beams) {
  const auto unit = static_cast<int>(reader.Take(kUnitBits));
  const bool on_line = reader.TakeFlag();
  const auto noise_bits = static_cast<int>(reader.Take(kNoiseBits));
  auto last = static_cast<uint32_t>(reader.TakeNumber());
  uint32_t before_last = last;
  std::vector<uint64_t> residuals(beams.size());  // of the first: 0
  reader.TakeAll(absl::MakeSpan(residuals).subspan(1), {.noise_bits = noise_bits});
  bool can_be = true;
  for (size_t k = 0; k < beams.size(); ++k) {
    const uint32_t number = Stepped(PredictRange(on_line, last, before_last), residuals[k]);
    before_last = std::exchange(last, number);
    float& range_m = beams[k].range_m;
    range_m = unit == kNumRangeUnits ? std::bit_cast<float>(number)
                                     : RangeOf(static_cast<int32_t>(number), kRangeUnits_um[unit]);
    can_be &= range_m >= 0 && range_m <= kMaxRange_m;
  }
  return can_be;
}

}  // namespace splinemap
