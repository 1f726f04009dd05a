#define SPLINEMAP_KERNEL avx2
#include "lib/mapping/scan_kernel_impl.h"
