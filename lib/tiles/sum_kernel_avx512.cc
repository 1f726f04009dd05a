#define SPLINEMAP_KERNEL avx512
#include "lib/tiles/sum_kernel_impl.h"
