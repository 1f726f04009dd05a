#define SPLINEMAP_KERNEL plain
#include "lib/map/point_kernel_impl.h"
