#include "tests/bench/fleet/process_figures.h"

#include <fmt/format.h>
#include <unistd.h>

#include <filesystem>
#include <fstream>
#include <string>

namespace splinemap::bench {
namespace {

// Calls it with an open file of each thread of the process.
template <typename Read>
void ForEachThread(pid_t pid, const std::string& name, Read read) {
  std::error_code error;
  for (const auto& task :
       std::filesystem::directory_iterator(fmt::format("/proc/{}/task", pid), error)) {
    std::ifstream file(task.path() / name);
    read(file);
  }
}

}  // namespace

double CpuSeconds(pid_t pid) {
  int64_t running_ns = 0;
  ForEachThread(pid, "schedstat", [&](std::ifstream& file) {
    int64_t of_thread_ns = 0;
    if (file >> of_thread_ns) running_ns += of_thread_ns;
  });
  return 1e-9 * static_cast<double>(running_ns);
}

int64_t Wakeups(pid_t pid) {
  const std::string field = "voluntary_ctxt_switches:";
  int64_t wakeups = 0;
  ForEachThread(pid, "status", [&](std::ifstream& file) {
    for (std::string line; std::getline(file, line);) {
      if (line.starts_with(field)) wakeups += std::stoll(line.substr(field.size()));
    }
  });
  return wakeups;
}

double ResidentBytes(pid_t pid) {
  std::ifstream file(fmt::format("/proc/{}/statm", pid));
  double size = 0;
  double resident = 0;
  file >> size >> resident;
  return resident * static_cast<double>(sysconf(_SC_PAGESIZE));
}

}  // namespace splinemap::bench
