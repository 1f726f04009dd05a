#pragma once

#include <algorithm>
#include <array>
#include <bit>
#include <cstdint>
#include <cstring>

#include "absl/types/span.h"

namespace splinemap {

// Streams of bits, the least significant of a byte first, and codes for numbers in them.
static_assert(std::endian::native == std::endian::little);

// Signed numbers as unsigned ones, small where their magnitude is.
inline uint64_t Zigzag(int64_t number) {
  return static_cast<uint64_t>(number) << 1 ^ static_cast<uint64_t>(number >> 63);
}
inline int64_t Unzigzag(uint64_t number) {
  return static_cast<int64_t>(number >> 1) ^ -static_cast<int64_t>(number & 1);
}

// The step between two numbers of 32 bits, and what it leads to, modulo 2^32.
inline uint64_t ZigzagStep(uint32_t from, uint32_t to) {
  return Zigzag(static_cast<int32_t>(to - from));
}
inline uint32_t Stepped(uint32_t from, uint64_t zigzag) {
  return from + static_cast<uint32_t>(Unzigzag(zigzag));
}

// The number of binary digits; 0 has none.
constexpr int NumDigits(uint64_t number) { return static_cast<int>(std::bit_width(number)); }

// Rice bits by the sum of two numbers; greater sums count as the last. Measured on recorded ranges:
// after a jump the next number is mostly small again.
inline constexpr std::array<uint8_t, 1024> kRiceBits = [] {
  std::array<uint8_t, 1024> bits{};
  for (size_t sum = 0; sum < bits.size(); ++sum) {
    const int digits = NumDigits(sum);
    bits[sum] = static_cast<uint8_t>(std::max(0, std::min(digits - 2, (digits + 3) / 2)));
  }
  return bits;
}();

// The magnitude of the next number, as far as the two before tell: adapts a Rice code. Numbers of
// many digits say `noise_bits` of them as they are.
struct RiceContext {
  int noise_bits = 0;
  uint64_t last = 2, before_last = 2;

  int RiceBits() const {
    return noise_bits +
           kRiceBits[std::min<uint64_t>((last + before_last) >> noise_bits, kRiceBits.size() - 1)];
  }
  void Add(uint64_t number) {
    before_last = last;
    last = number;
  }
};

// Codes of numbers below 2^50 have fewer digits, and may take twice as many bits as are put at
// once.
inline constexpr int kMaxDigits = 52;
inline constexpr int kMaxBitsAtOnce = 56;

class BitWriter {
 public:
  // `to` has room for what will be put, and for 8 bytes more.
  explicit BitWriter(uint8_t* to) : begin_(to), to_(to) {}

  // Requires bits < 2^count and count <= kMaxBitsAtOnce.
  void Put(uint64_t bits, int count) {
    bits_ |= bits << count_;
    count_ += count;
    std::memcpy(to_, &bits_, sizeof bits_);
    to_ += count_ >> 3;
    bits_ >>= count_ & ~7;
    count_ &= 7;
  }
  void PutFlag(bool flag) { Put(flag ? 1 : 0, 1); }
  void PutFloat(float number) { Put(std::bit_cast<uint32_t>(number), 32); }

  // How many digits the number has above its last rice_bits, in unary; then all of it but the top
  // one of these digits. So a Rice code for small numbers, and a jump costs twice its digits.
  // Requires number < 2^50.
  void PutRice(uint64_t number, int rice_bits) {
    const uint64_t quotient = number >> rice_bits;
    const int below_top = NumDigits(quotient | 1) - 1;
    const int digits = below_top + (quotient != 0 ? 1 : 0);
    const int count = rice_bits + below_top;
    const uint64_t rest = number & ((uint64_t{1} << count) - 1);
    if (digits + 1 + count <= kMaxBitsAtOnce) {
      Put((rest << 1 | 1) << digits, digits + 1 + count);
    } else {
      Put(uint64_t{1} << digits, digits + 1);
      Put(rest, count);
    }
  }
  void PutRice(uint64_t number, RiceContext& context) {
    PutRice(number, context.RiceBits());
    context.Add(number);
  }
  void PutAll(absl::Span<const uint64_t> numbers, RiceContext context) {
    BitWriter writer = *this;  // in registers: what is written might be any object in memory
    for (const uint64_t number : numbers) writer.PutRice(number, context);
    *this = writer;
  }
  // A number of any magnitude below 2^50.
  void PutNumber(uint64_t number) {
    const int width = NumDigits(number);
    PutRice(static_cast<uint64_t>(width), 3);
    Put(number, width);
  }

  // How many bytes there are, the last one filled up with zeros.
  size_t size() const { return static_cast<size_t>(to_ - begin_) + (count_ > 0 ? 1 : 0); }

 private:
  uint8_t* begin_;
  uint8_t* to_;
  uint64_t bits_ = 0;  // that do not fill a byte yet
  int count_ = 0;
};

// Reads what a BitWriter wrote, or any bytes: then numbers are some numbers, and zeros follow the
// end.
class BitReader {
 public:
  explicit BitReader(absl::Span<const uint8_t> bytes) : bytes_(bytes) {}

  // Requires count <= kMaxBitsAtOnce.
  uint64_t Take(int count) {
    const uint64_t bits = Window() & ((uint64_t{1} << count) - 1);
    position_ += static_cast<size_t>(count);
    return bits;
  }
  bool TakeFlag() { return Take(1) != 0; }
  float TakeFloat() { return std::bit_cast<float>(static_cast<uint32_t>(Take(32))); }

  uint64_t TakeRice(int rice_bits) {
    const uint64_t window = Window();
    const int digits = std::countr_zero(window | uint64_t{1} << kMaxDigits);
    const uint64_t has_top = digits != 0 ? 1 : 0;
    const int count = std::min(rice_bits + digits - static_cast<int>(has_top), kMaxBitsAtOnce);
    uint64_t rest = window >> (digits + 1);
    position_ += static_cast<size_t>(digits + 1);
    if (digits + 1 + count > kMaxBitsAtOnce) rest = Window();
    position_ += static_cast<size_t>(count);
    return has_top << count | (rest & ((uint64_t{1} << count) - 1));
  }
  uint64_t TakeRice(RiceContext& context) {
    const uint64_t number = TakeRice(context.RiceBits());
    context.Add(number);
    return number;
  }
  void TakeAll(absl::Span<uint64_t> numbers, RiceContext context) {
    BitReader reader = *this;
    for (uint64_t& number : numbers) number = reader.TakeRice(context);
    *this = reader;
  }
  uint64_t TakeNumber() {
    return Take(static_cast<int>(std::min<uint64_t>(TakeRice(3), kMaxBitsAtOnce)));
  }

  // Negative beyond the end.
  int64_t bits_left() const {
    return 8 * static_cast<int64_t>(bytes_.size()) - static_cast<int64_t>(position_);
  }

 private:
  // The next 57 bits at least.
  uint64_t Window() const {
    const size_t byte = position_ >> 3;
    uint64_t window = 0;
    if (byte + sizeof window <= bytes_.size()) {
      std::memcpy(&window, bytes_.data() + byte, sizeof window);
    } else if (byte < bytes_.size()) {
      std::memcpy(&window, bytes_.data() + byte, bytes_.size() - byte);
    }
    return window >> (position_ & 7);
  }

  absl::Span<const uint8_t> bytes_;
  size_t position_ = 0;  // in bits
};

}  // namespace splinemap
