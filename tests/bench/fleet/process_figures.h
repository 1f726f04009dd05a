#pragma once

#include <sys/types.h>

#include <cstdint>

namespace splinemap::bench {

// Of all threads of a process, from /proc; 0 where it is gone.
double CpuSeconds(pid_t pid);
// The same with threads that have ended, to 10 ms.
double CpuSecondsOfAll(pid_t pid);
int64_t Wakeups(pid_t pid);  // how often they waited for something, and it came
double ResidentBytes(pid_t pid);

}  // namespace splinemap::bench
