#define SPLINEMAP_KERNEL avx512
#include "lib/distance/distance_kernel_impl.h"
