// The body of a ScanKernel, included by one file for each instruction set, which defines
// SPLINEMAP_KERNEL as the name of its namespace.
//
// What is called in here is local to the file, always inlined, or not inline at all: an inline
// function that the linker took from here into the rest of the program might not run there.

#include "lib/base/kernels.h"
#include "lib/mapping/kernel_commit.h"
#include "lib/mapping/kernel_faces.h"
#include "lib/mapping/kernel_lines.h"
#include "lib/mapping/kernel_sums.h"

namespace splinemap::SPLINEMAP_KERNEL {

extern const ScanKernel kScanKernel;
const ScanKernel kScanKernel{SPLINEMAP_KERNEL_NAME,
                             &SetLines,
                             &SetHits,
                             &SetFaces,
                             &SetFaceLines,
                             &AddLines<int32_t>,
                             &AddLines<uint16_t>,
                             &AddFaces,
                             &AddSamples,
                             {&MoveApron<int32_t>, &MoveTransposed<int32_t>},
                             {&MoveApron<uint16_t>, &MoveTransposed<uint16_t>},
                             {&MoveApron<FaceSum>, &MoveTransposed<FaceSum>},
                             &HasChange,
                             &Commit,
                             &CommitDistances};

}  // namespace splinemap::SPLINEMAP_KERNEL
