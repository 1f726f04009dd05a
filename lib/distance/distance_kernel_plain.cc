#define SPLINEMAP_KERNEL plain
#include "lib/distance/distance_kernel_impl.h"
