#pragma once

#include <cstdint>

namespace splinemap {

// A program that links this file has the kernel refuse, on every UDP socket from before it is
// bound, datagrams that crash each process with liblcm 1.3.1, whoever sends them:
// * A channel name that does not end within the datagram, or not after the 63 characters that a
//   name may have. Sizes are computed from where it ends, and become negative.
// * A fragment that claims a place beyond the message. The sum of place and size overflows before
//   it is compared.
// Also those that claim to be of a message beyond 1 MB, which liblcm would allocate: a scan of
// kMaxBeams has a third of that. What is no LCM datagram passes. Where the kernel cannot filter,
// nothing changes.

// Datagrams that the kernel dropped on the UDP sockets of this process since they are open, because
// their buffer was full. What is refused as above does not count.
int64_t CountLostDatagrams();

}  // namespace splinemap
