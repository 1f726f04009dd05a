#include "lib/mapping/scan_kernel.h"

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
  static const std::vector<ScanKernel> kernels = [] {
    std::vector<ScanKernel> runnable{plain::kScanKernel};
#ifdef __x86_64__
    if (__builtin_cpu_supports("sse4.1")) runnable.push_back(sse4::kScanKernel);
    const bool has_bmi = __builtin_cpu_supports("bmi") && __builtin_cpu_supports("bmi2");
    if (has_bmi && __builtin_cpu_supports("avx2")) runnable.push_back(avx2::kScanKernel);
    if (has_bmi && __builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512bw") &&
        __builtin_cpu_supports("avx512dq") && __builtin_cpu_supports("avx512vl")) {
      runnable.push_back(avx512::kScanKernel);
    }
#endif
#ifdef __aarch64__
    runnable.push_back(neon::kScanKernel);  // all of them have it
#endif
    return runnable;
  }();
  return kernels;
}

}  // namespace splinemap
