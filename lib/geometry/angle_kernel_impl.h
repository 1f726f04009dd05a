// The body of an AngleKernel, included by one file for each instruction set, which defines
// SPLINEMAP_KERNEL as the name of its namespace.
//
// What is called in here is local to the file or always inlined: an inline function that the linker
// took from here into the rest of the program might not run there.

#include "lib/base/kernels.h"
#include "lib/base/lanes.h"
#include "lib/geometry/angle.h"
#include "lib/geometry/angle_kernel.h"

namespace splinemap::SPLINEMAP_KERNEL {
namespace {

// As UnitVector().
void SetUnits(const double* angles_rad, size_t count, double* units) {
  for (size_t k = 0; k < count; k += 4) {
    const auto angle_rad = Load<Doubles4>(angles_rad + k);
    const Doubles4 n = Floor(angle_rad * (2 / M_PI) + 0.5);
    const Longs4 quarters = __builtin_convertvector(__builtin_convertvector(n, Integers4), Longs4);
    const SineAndCosine<Doubles4> of_r((angle_rad - n * kHalfPiHigh) - n * kHalfPiLow);
    const Longs4 is_odd = -(quarters & 1);
    const Doubles4 x = Select(is_odd, of_r.sine, of_r.cosine);
    const Doubles4 y = Select(is_odd, of_r.cosine, of_r.sine);
    const Longs4 sign_of_x = ((quarters + 1) & 2) << 62;
    const Longs4 sign_of_y = (quarters & 2) << 62;
    const auto signed_x = reinterpret_cast<Doubles4>(reinterpret_cast<Longs4>(x) ^ sign_of_x);
    const auto signed_y = reinterpret_cast<Doubles4>(reinterpret_cast<Longs4>(y) ^ sign_of_y);
    Store(__builtin_shufflevector(signed_x, signed_y, 0, 4, 1, 5), units + 2 * k);
    Store(__builtin_shufflevector(signed_x, signed_y, 2, 6, 3, 7), units + 2 * k + 4);
  }
}

}  // namespace

extern const AngleKernel kAngleKernel;
const AngleKernel kAngleKernel{SPLINEMAP_KERNEL_NAME, &SetUnits};

}  // namespace splinemap::SPLINEMAP_KERNEL
