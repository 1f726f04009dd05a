#pragma once

#include <cstdint>
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
typedef int32_t Integers4 __attribute__((vector_size(16)));

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

}  // namespace splinemap
