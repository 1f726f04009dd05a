#include "lib/geometry/angle_kernel.h"

#include "lib/base/kernels.h"

namespace splinemap {

namespace plain {
extern const AngleKernel kAngleKernel;
}
#ifdef __x86_64__
namespace avx2 {
extern const AngleKernel kAngleKernel;
}
#endif

const std::vector<AngleKernel>& AngleKernels() {
  static const std::vector<AngleKernel> kernels = Runnable<AngleKernel>({
      &plain::kAngleKernel,
#ifdef __x86_64__
      &avx2::kAngleKernel,
#endif
  });
  return kernels;
}

}  // namespace splinemap
