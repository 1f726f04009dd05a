#pragma once

#include <cstdint>

namespace splinemap {

// Has the kernel refuse, on the UDP sockets that this process has now, datagrams that crash every
// process with liblcm 1.3.1, whoever sends them:
// * A channel name that does not end within the datagram, or not after the 63 characters that a
//   name may have. Sizes are computed from where it ends, and become negative.
// * A fragment that claims a place beyond the message. The sum of place and size overflows before
//   it is compared.
// Also those that claim to be of a message beyond 1 MB, which liblcm would allocate: a scan of
// kMaxBeams has a third of that. What is no LCM datagram passes. Where the kernel cannot filter,
// nothing changes.
void GuardUdpSockets();

// Datagrams that the kernel dropped on those sockets since they are open, because their buffer was
// full. What the guard refuses does not count.
int64_t CountLostDatagrams();

}  // namespace splinemap
