#define SPLINEMAP_KERNEL avx2
#include "lib/tiles/sum_kernel_impl.h"
