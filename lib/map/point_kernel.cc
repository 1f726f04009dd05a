#include "lib/map/point_kernel.h"

namespace splinemap {

namespace plain {
extern const PointKernel kPointKernel;
}
#ifdef __x86_64__
namespace avx2 {
extern const PointKernel kPointKernel;
}
namespace avx512 {
extern const PointKernel kPointKernel;
}
#endif

const std::vector<PointKernel>& PointKernels() {
  static const std::vector<PointKernel> kernels = [] {
    std::vector<PointKernel> runnable{plain::kPointKernel};
#ifdef __x86_64__
    if (__builtin_cpu_supports("avx2")) runnable.push_back(avx2::kPointKernel);
    if (__builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512vl") &&
        __builtin_cpu_supports("avx512dq")) {
      runnable.push_back(avx512::kPointKernel);
    }
#endif
    return runnable;
  }();
  return kernels;
}

}  // namespace splinemap
