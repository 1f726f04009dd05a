#include "tests/bench/fleet/process_figures.h"

#include <fmt/format.h>
#include <unistd.h>

#include <algorithm>
#include <filesystem>
#include <fstream>
#include <sstream>
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

double CpuSecondsOfAll(pid_t pid) {
  std::ifstream file(fmt::format("/proc/{}/stat", pid));
  std::string text;
  std::getline(file, text);
  // Behind the name, which may have spaces: the state, 10 numbers, and then these two (proc(5)).
  std::istringstream fields(text.substr(std::min(text.rfind(')') + 1, text.size())));
  std::string skipped;
  for (int k = 0; k < 11; ++k) fields >> skipped;
  double user = 0;
  double system = 0;
  fields >> user >> system;
  return (user + system) / static_cast<double>(sysconf(_SC_CLK_TCK));
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
