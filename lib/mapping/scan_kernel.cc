#include "lib/mapping/scan_kernel.h"

#include "lib/base/kernels.h"

namespace splinemap {

namespace plain {
extern const ScanKernel kScanKernel;
}
#ifdef __x86_64__
namespace sse4 {
extern const ScanKernel kScanKernel;
}
namespace avx2 {
extern const ScanKernel kScanKernel;
}
namespace avx512 {
extern const ScanKernel kScanKernel;
}
#endif
#ifdef __aarch64__
namespace neon {
extern const ScanKernel kScanKernel;
}
#endif

const std::vector<ScanKernel>& ScanKernels() {
  static const std::vector<ScanKernel> kernels = Runnable<ScanKernel>({
      &plain::kScanKernel,
#ifdef __x86_64__
      &sse4::kScanKernel,
      &avx2::kScanKernel,
      &avx512::kScanKernel,
#endif
#ifdef __aarch64__
      &neon::kScanKernel,
#endif
  });
  return kernels;
}

}  // namespace splinemap
