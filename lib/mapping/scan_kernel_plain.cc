#define SPLINEMAP_KERNEL plain
#include "lib/mapping/scan_kernel_impl.h"
