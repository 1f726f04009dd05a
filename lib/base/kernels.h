#pragma once

#include <initializer_list>
#include <string_view>
#include <vector>

// The name of the instruction set that a file NAME_SET.cc is compiled for, which defines
// SPLINEMAP_KERNEL as that, see splinemap_kernels() in CMakeLists.txt.
#define SPLINEMAP_STRING(x) #x
#define SPLINEMAP_NAME(x) SPLINEMAP_STRING(x)
#define SPLINEMAP_KERNEL_NAME SPLINEMAP_NAME(SPLINEMAP_KERNEL)

namespace splinemap {

// Whether this processor has "plain", "sse4", "avx2", "avx512" or "neon", with all that
// splinemap_kernels() has a compiler use for it.
bool HasInstructions(std::string_view set);

// Of kernels, structs of functions with the `name` of their instruction set, those that this
// processor can run, in the same order.
template <typename Kernel>
std::vector<Kernel> Runnable(std::initializer_list<const Kernel*> kernels) {
  std::vector<Kernel> runnable;
  for (const Kernel* kernel : kernels) {
    if (HasInstructions(kernel->name)) runnable.push_back(*kernel);
  }
  return runnable;
}

}  // namespace splinemap
