#include "lib/base/kernels.h"

namespace splinemap {

bool HasInstructions(std::string_view set) {
  if (set == "plain") return true;
#ifdef __x86_64__
  const bool has_bmi = __builtin_cpu_supports("bmi") && __builtin_cpu_supports("bmi2");
  if (set == "sse4") return __builtin_cpu_supports("sse4.1");
  if (set == "avx2") return has_bmi && __builtin_cpu_supports("avx2");
  if (set == "avx512") {
    return has_bmi && __builtin_cpu_supports("fma") && __builtin_cpu_supports("avx512f") &&
           __builtin_cpu_supports("avx512bw") && __builtin_cpu_supports("avx512dq") &&
           __builtin_cpu_supports("avx512vl");
  }
#endif
#ifdef __aarch64__
  if (set == "neon") return true;  // all of them have it
#endif
  return false;
}

}  // namespace splinemap
