#define SPLINEMAP_KERNEL plain
#include "lib/geometry/angle_kernel_impl.h"
