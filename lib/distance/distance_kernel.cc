#include "lib/distance/distance_kernel.h"

namespace splinemap {

namespace plain {
extern const DistanceKernel kDistanceKernel;
}
#ifdef __x86_64__
namespace avx2 {
extern const DistanceKernel kDistanceKernel;
}
namespace avx512 {
extern const DistanceKernel kDistanceKernel;
}
#endif

const std::vector<DistanceKernel>& DistanceKernels() {
  static const std::vector<DistanceKernel> kernels = [] {
    std::vector<DistanceKernel> runnable{plain::kDistanceKernel};
#ifdef __x86_64__
    if (__builtin_cpu_supports("avx2")) runnable.push_back(avx2::kDistanceKernel);
    if (__builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512vl")) {
      runnable.push_back(avx512::kDistanceKernel);
    }
#endif
    return runnable;
  }();
  return kernels;
}

}  // namespace splinemap
