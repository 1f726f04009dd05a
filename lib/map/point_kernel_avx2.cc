#define SPLINEMAP_KERNEL avx2
#include "lib/map/point_kernel_impl.h"
