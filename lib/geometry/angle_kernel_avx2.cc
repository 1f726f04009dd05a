#define SPLINEMAP_KERNEL avx2
#include "lib/geometry/angle_kernel_impl.h"
