#pragma once

#include <cstdint>

// For code that is compiled twice: for every processor, and inlined in functions for AVX2.
#define SPLINEMAP_INLINE __attribute__((always_inline)) inline

namespace splinemap {

typedef int32_t Integers8 __attribute__((vector_size(32)));

#ifdef __x86_64__
inline const bool has_avx2 = __builtin_cpu_supports("avx2");
#endif

}  // namespace splinemap
