#pragma once

// Vectors of one instruction set, and what kernels do with them. A part of scan_kernel_impl.h.

#include <cstddef>
#include <cstdint>
#ifdef __SSE2__
#include <immintrin.h>
#endif
#ifdef SPLINEMAP_NEON
#include <arm_neon.h>
#endif

#include "lib/base/lanes.h"
#include "lib/mapping/scan_kernel.h"

namespace splinemap::SPLINEMAP_KERNEL {
namespace {

// As many sums as a register of the instruction set holds.
#if defined(__AVX512F__)
constexpr int kLanes = 16;
#elif defined(__AVX2__)
constexpr int kLanes = 8;
#else
constexpr int kLanes = 4;
#endif

// Vectors of GCC and Clang, for every processor.
using Int32x4 [[gnu::vector_size(16)]] = int32_t;
using Int32x8 = Integers8;
using Floats4 [[gnu::vector_size(16)]] = float;
using Uint16x8 [[gnu::vector_size(16)]] = uint16_t;
using Sums [[gnu::vector_size(4 * kLanes)]] = int32_t;
using Shares [[gnu::vector_size(4 * kLanes)]] = float;
using ControlPoints [[gnu::vector_size(2 * kLanes)]] = int16_t;
// As many control points as a register holds, and their weights.
using WholeControlPoints [[gnu::vector_size(4 * kLanes)]] = int16_t;
using WholeWeights [[gnu::vector_size(4 * kLanes)]] = uint16_t;
using HalfWeights [[gnu::vector_size(2 * kLanes)]] = uint16_t;

constexpr int kSide = Tile::kSide;
template <typename Sum>
constexpr int kStride = SumBlock<Sum>::kStride;
constexpr int kRowsPerGroup = RowGroups::kRows;
// Of all blocks.
constexpr int kBlockRows = SumBlock<int32_t>::kRows;
constexpr int kBlockShift = 7;
static_assert(kBlockRows == 1 << kBlockShift);

// Eight sums, or four of faces.
template <typename Sum>
struct RowOf;
template <>
struct RowOf<int32_t> {
  using Type = Int32x8;
};
template <>
struct RowOf<uint16_t> {
  using Type = Uint16x8;
};
template <>
struct RowOf<FaceSum> {
  using Type = Int32x8;
};
template <typename Sum>
using Row = typename RowOf<Sum>::Type;

template <typename Vector>
[[gnu::always_inline]] inline Vector Plus(Vector a, Vector b) {
  return a + b;
}
// Weights in 16 bits saturate.
[[gnu::always_inline]] inline Uint16x8 Plus(Uint16x8 a, Uint16x8 b) {
#ifdef __SSE2__
  return reinterpret_cast<Uint16x8>(
      _mm_adds_epu16(reinterpret_cast<__m128i>(a), reinterpret_cast<__m128i>(b)));
#elif defined(SPLINEMAP_NEON)
  return reinterpret_cast<Uint16x8>(
      vqaddq_u16(reinterpret_cast<uint16x8_t>(a), reinterpret_cast<uint16x8_t>(b)));
#else
  const Uint16x8 sum = a + b;
  return sum < a ? ~Uint16x8{} : sum;
#endif
}

template <typename Vector>
void AddTo(Vector vector, void* to) {
  Store(Plus(Load<Vector>(to), vector), to);
}

// What the compiler makes of the plain expressions for the following is slow or, in parts, scalar.
bool IsZero(Int32x4 v) {
#ifdef __SSE2__
  const __m128i is_zero = _mm_cmpeq_epi32(reinterpret_cast<__m128i>(v), _mm_setzero_si128());
  return _mm_movemask_epi8(is_zero) == 0xffff;
#elif defined(SPLINEMAP_NEON)
  return vmaxvq_u32(reinterpret_cast<uint32x4_t>(v)) == 0;
#else
  return (v[0] | v[1] | v[2] | v[3]) == 0;
#endif
}
bool IsZero(Uint16x8 v) { return IsZero(reinterpret_cast<Int32x4>(v)); }
bool IsZero(Int32x8 v) {
#ifdef __AVX2__
  const auto whole = reinterpret_cast<__m256i>(v);
  return _mm256_testz_si256(whole, whole) != 0;
#else
  return IsZero(__builtin_shufflevector(v, v, 0, 1, 2, 3) |
                __builtin_shufflevector(v, v, 4, 5, 6, 7));
#endif
}
#ifdef __AVX512F__
bool IsZero(Sums v) {
  const auto whole = reinterpret_cast<__m512i>(v);
  return _mm512_test_epi32_mask(whole, whole) == 0;
}
#endif
Sums Widen(ControlPoints v) {
#if defined(__SSE2__) && !defined(__AVX2__)
  const __m128i low = _mm_cvtsi64_si128(reinterpret_cast<int64_t>(v));
  return reinterpret_cast<Sums>(_mm_srai_epi32(_mm_unpacklo_epi16(low, low), 16));
#elif defined(SPLINEMAP_NEON)
  return reinterpret_cast<Sums>(vmovl_s16(reinterpret_cast<int16x4_t>(v)));
#else
  return __builtin_convertvector(v, Sums);
#endif
}
Sums Widen(HalfWeights v) {
#ifdef SPLINEMAP_NEON
  return reinterpret_cast<Sums>(vmovl_u16(reinterpret_cast<uint16x4_t>(v)));
#else
  return __builtin_convertvector(v, Sums);
#endif
}

WholeControlPoints Narrow(Sums a, Sums b) {
#if defined(__AVX2__) && !defined(__AVX512F__)
  const __m256i packed =
      _mm256_packs_epi32(reinterpret_cast<__m256i>(a), reinterpret_cast<__m256i>(b));
  return reinterpret_cast<WholeControlPoints>(_mm256_permute4x64_epi64(packed, 0xd8));
#elif defined(__SSE2__) && !defined(__AVX512F__)
  return reinterpret_cast<WholeControlPoints>(
      _mm_packs_epi32(reinterpret_cast<__m128i>(a), reinterpret_cast<__m128i>(b)));
#else
  const ControlPoints halves[] = {__builtin_convertvector(a, ControlPoints),
                                  __builtin_convertvector(b, ControlPoints)};
#if defined(__AVX512F__)
  return __builtin_shufflevector(halves[0], halves[1], 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13,
                                 14, 15, 16, 17, 18, 19, 20, 21, 22, 23, 24, 25, 26, 27, 28, 29, 30,
                                 31);
#else
  return __builtin_shufflevector(halves[0], halves[1], 0, 1, 2, 3, 4, 5, 6, 7);
#endif
#endif
}

// Takes pairs apart.
[[gnu::always_inline]] inline void Split(Sums a, Sums b, Sums& first, Sums& second) {
#if defined(__AVX512F__)
  first = __builtin_shufflevector(a, b, 0, 2, 4, 6, 8, 10, 12, 14, 16, 18, 20, 22, 24, 26, 28, 30);
  second = __builtin_shufflevector(a, b, 1, 3, 5, 7, 9, 11, 13, 15, 17, 19, 21, 23, 25, 27, 29, 31);
#elif defined(__AVX2__)
  first = __builtin_shufflevector(a, b, 0, 2, 4, 6, 8, 10, 12, 14);
  second = __builtin_shufflevector(a, b, 1, 3, 5, 7, 9, 11, 13, 15);
#else
  first = __builtin_shufflevector(a, b, 0, 2, 4, 6);
  second = __builtin_shufflevector(a, b, 1, 3, 5, 7);
#endif
}

[[gnu::always_inline]] inline Int32x8 Joined(Integers4 a, Integers4 b) {
#ifdef __AVX2__
  return __builtin_shufflevector(a, b, 0, 1, 2, 3, 4, 5, 6, 7);
#else
  const Integers4 both[] = {a, b};
  return Load<Int32x8>(both);
#endif
}

// Lays those of the first halves, and of the second, by turns.
[[gnu::always_inline]] inline void Interleave(Int32x8 a, Int32x8 b, Int32x8& first,
                                              Int32x8& second) {
#ifdef __AVX2__
  first = __builtin_shufflevector(a, b, 0, 8, 1, 9, 2, 10, 3, 11);
  second = __builtin_shufflevector(a, b, 4, 12, 5, 13, 6, 14, 7, 15);
#else
  Int32x4 as[2];
  Int32x4 bs[2];
  __builtin_memcpy(as, &a, sizeof a);
  __builtin_memcpy(bs, &b, sizeof b);
  Int32x8* const both[] = {&first, &second};
  for (int k = 0; k < 2; ++k) {
    const Int32x4 halves[] = {__builtin_shufflevector(as[k], bs[k], 0, 4, 1, 5),
                              __builtin_shufflevector(as[k], bs[k], 2, 6, 3, 7)};
    *both[k] = Load<Int32x8>(halves);
  }
#endif
}

// The groups that a range of rows lies in.
uint32_t GroupsOf(uint32_t first_row, uint32_t last_row) {
  return (2u << (last_row / kRowsPerGroup)) - (1u << (first_row / kRowsPerGroup));
}

Doubles4 Abs(Doubles4 x) {
  return reinterpret_cast<Doubles4>(reinterpret_cast<Longs4>(x) & INT64_MAX);
}

Doubles4 SquareRoot(Doubles4 x) {
#if defined(__AVX__)
  return reinterpret_cast<Doubles4>(_mm256_sqrt_pd(reinterpret_cast<__m256d>(x)));
#elif defined(SPLINEMAP_NEON)
  float64x2_t halves[2];
  __builtin_memcpy(halves, &x, sizeof x);
  for (float64x2_t& half : halves) half = vsqrtq_f64(half);
  return Load<Doubles4>(halves);
#else
  for (int k = 0; k < 4; ++k) x[k] = __builtin_sqrt(x[k]);
  return x;
#endif
}

// Exchanges rows and columns.
[[gnu::always_inline]] inline void Transpose(Doubles4 (&r)[4]) {
#ifdef __AVX2__
  const Doubles4 low01 = __builtin_shufflevector(r[0], r[1], 0, 4, 2, 6);
  const Doubles4 high01 = __builtin_shufflevector(r[0], r[1], 1, 5, 3, 7);
  const Doubles4 low23 = __builtin_shufflevector(r[2], r[3], 0, 4, 2, 6);
  const Doubles4 high23 = __builtin_shufflevector(r[2], r[3], 1, 5, 3, 7);
  r[0] = __builtin_shufflevector(low01, low23, 0, 1, 4, 5);
  r[1] = __builtin_shufflevector(high01, high23, 0, 1, 4, 5);
  r[2] = __builtin_shufflevector(low01, low23, 2, 3, 6, 7);
  r[3] = __builtin_shufflevector(high01, high23, 2, 3, 6, 7);
#else
  using Half [[gnu::vector_size(16)]] = double;
  Half from[4][2];
  __builtin_memcpy(from, r, sizeof r);
  for (int k = 0; k < 2; ++k) {
    const Half rows[2][2] = {{__builtin_shufflevector(from[0][k], from[1][k], 0, 2),
                              __builtin_shufflevector(from[2][k], from[3][k], 0, 2)},
                             {__builtin_shufflevector(from[0][k], from[1][k], 1, 3),
                              __builtin_shufflevector(from[2][k], from[3][k], 1, 3)}};
    r[2 * k] = Load<Doubles4>(rows[0]);
    r[2 * k + 1] = Load<Doubles4>(rows[1]);
  }
#endif
}

// Likewise: lays the elements of the one half of the rows between those of the other, twice.
[[gnu::always_inline]] inline void Transpose(Integers4 (&r)[4]) {
  for (int step = 0; step < 2; ++step) {
    const Integers4 t[4] = {__builtin_shufflevector(r[0], r[2], 0, 4, 1, 5),
                            __builtin_shufflevector(r[0], r[2], 2, 6, 3, 7),
                            __builtin_shufflevector(r[1], r[3], 0, 4, 1, 5),
                            __builtin_shufflevector(r[1], r[3], 2, 6, 3, 7)};
    for (int k = 0; k < 4; ++k) r[k] = t[k];
  }
}

}  // namespace
}  // namespace splinemap::SPLINEMAP_KERNEL
