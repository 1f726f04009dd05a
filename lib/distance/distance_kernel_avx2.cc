#define SPLINEMAP_KERNEL avx2
#include "lib/distance/distance_kernel_impl.h"
