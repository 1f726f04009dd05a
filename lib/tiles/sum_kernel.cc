#include "lib/tiles/sum_kernel.h"

#include "lib/base/kernels.h"

namespace splinemap {

namespace plain {
extern const SumKernel kSumKernel;
}
#ifdef __x86_64__
namespace avx2 {
extern const SumKernel kSumKernel;
}
namespace avx512 {
extern const SumKernel kSumKernel;
}
#endif
#ifdef __aarch64__
namespace neon {
extern const SumKernel kSumKernel;
}
#endif

const std::vector<SumKernel>& SumKernels() {
  static const std::vector<SumKernel> kernels = Runnable<SumKernel>({
      &plain::kSumKernel,
#ifdef __x86_64__
      &avx2::kSumKernel,
      &avx512::kSumKernel,
#endif
#ifdef __aarch64__
      &neon::kSumKernel,
#endif
  });
  return kernels;
}

}  // namespace splinemap
