#define SPLINEMAP_KERNEL neon
#define SPLINEMAP_NEON
#include "lib/mapping/scan_kernel_impl.h"
