#define SPLINEMAP_KERNEL sse4
#include "lib/mapping/scan_kernel_impl.h"
