#define SPLINEMAP_KERNEL plain
#include "lib/tiles/sum_kernel_impl.h"
