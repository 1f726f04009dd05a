#define SPLINEMAP_KERNEL neon
#define SPLINEMAP_NEON
#include "lib/tiles/sum_kernel_impl.h"
