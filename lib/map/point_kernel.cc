#include "lib/map/point_kernel.h"

#include "lib/base/kernels.h"

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
  static const std::vector<PointKernel> kernels = Runnable<PointKernel>({
      &plain::kPointKernel,
#ifdef __x86_64__
      &avx2::kPointKernel,
      &avx512::kPointKernel,
#endif
  });
  return kernels;
}

}  // namespace splinemap
