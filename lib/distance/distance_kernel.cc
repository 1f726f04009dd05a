#include "lib/distance/distance_kernel.h"

#include "lib/base/kernels.h"

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
  static const std::vector<DistanceKernel> kernels = Runnable<DistanceKernel>({
      &plain::kDistanceKernel,
#ifdef __x86_64__
      &avx2::kDistanceKernel,
      &avx512::kDistanceKernel,
#endif
  });
  return kernels;
}

}  // namespace splinemap
