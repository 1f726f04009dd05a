#pragma once

#include <cstdint>
#include <type_traits>
#ifdef __SSE4_1__
#include <immintrin.h>
#endif

namespace splinemap {

// Vectors of GCC and Clang, which split them where a processor has narrower ones. How functions
// pass them depends on the instructions they are compiled for (-Wpsabi), and so functions that take
// or give them are always inlined.
typedef double Doubles4 __attribute__((vector_size(32)));
typedef uint64_t Words4 __attribute__((vector_size(32)));
typedef int64_t Longs4 __attribute__((vector_size(32)));
typedef double Doubles8 __attribute__((vector_size(64)));
typedef uint64_t Words8 __attribute__((vector_size(64)));
typedef int32_t Integers4 __attribute__((vector_size(16)));
typedef int32_t Integers8 __attribute__((vector_size(32)));
typedef float Floats8 __attribute__((vector_size(32)));

template <typename Vector>
[[gnu::always_inline]] inline Vector Load(const void* from) {
  Vector vector;
  __builtin_memcpy(&vector, from, sizeof vector);
  return vector;
}

template <typename Vector>
[[gnu::always_inline]] inline void Store(Vector vector, void* to) {
  __builtin_memcpy(to, &vector, sizeof vector);
}

// GCC 12 converts them in halves.
[[gnu::always_inline]] inline Doubles4 ToDoubles(Integers4 x) {
#ifdef __AVX__
  return reinterpret_cast<Doubles4>(_mm256_cvtepi32_pd(reinterpret_cast<__m128i>(x)));
#else
  return __builtin_convertvector(x, Doubles4);
#endif
}

// The greatest integers that are not greater, which 32 bits must be able to hold.
[[gnu::always_inline]] inline Doubles4 Floor(Doubles4 x) {
#ifdef __AVX__
  return reinterpret_cast<Doubles4>(_mm256_floor_pd(reinterpret_cast<__m256d>(x)));
#elif defined(__SSE4_1__)
  __m128d halves[2];
  __builtin_memcpy(halves, &x, sizeof(x));
  for (__m128d& half : halves) half = _mm_floor_pd(half);
  __builtin_memcpy(&x, halves, sizeof(x));
  return x;
#elif defined(__aarch64__)
  for (int k = 0; k < 4; ++k) x[k] = __builtin_floor(x[k]);  // one instruction for two of them
  return x;
#else
  const Doubles4 towards_zero = ToDoubles(__builtin_convertvector(x, Integers4));
  return towards_zero - (towards_zero > x ? Doubles4{} + 1 : Doubles4{});
#endif
}

// Compilers take comparisons of vectors that are wider than the registers apart into scalars, and
// what follows from them, too. Of 32 bytes, as all of the following:
template <typename Vector>
using MaskOf = decltype(Vector{} < Vector{});

template <typename Vector>
[[gnu::always_inline]] inline MaskOf<Vector> IsLess(Vector a, Vector b) {
#ifdef __AVX2__
  return a < b;
#else
  using Half [[gnu::vector_size(16)]] = std::remove_cvref_t<decltype(a[0])>;
  Half as[2];
  Half bs[2];
  __builtin_memcpy(as, &a, sizeof a);
  __builtin_memcpy(bs, &b, sizeof b);
  const decltype(as[0] < bs[0]) masks[] = {as[0] < bs[0], as[1] < bs[1]};
  return Load<MaskOf<Vector> >(masks);
#endif
}
template <typename Mask, typename Vector>
[[gnu::always_inline]] inline Vector Select(Mask mask, Vector a, Vector b) {
#ifdef __AVX2__
  return mask ? a : b;
#else
  return reinterpret_cast<Vector>((mask & reinterpret_cast<Mask>(a)) |
                                  (~mask & reinterpret_cast<Mask>(b)));
#endif
}
// Of numbers.
template <typename Vector>
[[gnu::always_inline]] inline Vector Lesser(Vector a, Vector b) {
  return Select(IsLess(a, b), a, b);
}
template <typename Vector>
[[gnu::always_inline]] inline Vector Greater(Vector a, Vector b) {
  return Select(IsLess(a, b), b, a);
}
#ifdef __AVX2__
template <>
[[gnu::always_inline]] inline Integers8 Lesser(Integers8 a, Integers8 b) {
  return reinterpret_cast<Integers8>(
      _mm256_min_epi32(reinterpret_cast<__m256i>(a), reinterpret_cast<__m256i>(b)));
}
template <>
[[gnu::always_inline]] inline Integers8 Greater(Integers8 a, Integers8 b) {
  return reinterpret_cast<Integers8>(
      _mm256_max_epi32(reinterpret_cast<__m256i>(a), reinterpret_cast<__m256i>(b)));
}
template <>
[[gnu::always_inline]] inline Floats8 Lesser(Floats8 a, Floats8 b) {
  return reinterpret_cast<Floats8>(
      _mm256_min_ps(reinterpret_cast<__m256>(a), reinterpret_cast<__m256>(b)));
}
template <>
[[gnu::always_inline]] inline Floats8 Greater(Floats8 a, Floats8 b) {
  return reinterpret_cast<Floats8>(
      _mm256_max_ps(reinterpret_cast<__m256>(a), reinterpret_cast<__m256>(b)));
}
#endif

}  // namespace splinemap
