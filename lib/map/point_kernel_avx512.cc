#define SPLINEMAP_KERNEL avx512
#include "lib/map/point_kernel_impl.h"
