#define SPLINEMAP_KERNEL avx512
#include "lib/mapping/scan_kernel_impl.h"
