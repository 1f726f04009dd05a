#include "tests/fuzz/fuzz.h"

#include <sys/mman.h>
#include <unistd.h>

#include <cstdio>
#include <cstdlib>
#include <map>

namespace splinemap {
namespace {

std::map<std::string, FuzzRun>& Targets() {
  static auto* const targets = new std::map<std::string, FuzzRun>();
  return *targets;
}

}  // namespace

FuzzTarget::FuzzTarget(const std::string& name, FuzzRun run) { Targets().emplace(name, run); }

FuzzRun FindFuzzTarget(const std::string& name) {
  const auto target = Targets().find(name);
  Require(target != Targets().end(), "a target of this name");
  return target->second;
}

void Require(bool condition, const char* what) {
  if (condition) return;
  std::fprintf(stderr, "required, and not so: %s\n", what);
  std::abort();
}

MemoryFile::MemoryFile()
    : descriptor_(memfd_create("fuzz", MFD_CLOEXEC)),
      path_("/proc/self/fd/" + std::to_string(descriptor_)) {
  Require(descriptor_ >= 0, "a file in memory");
}

MemoryFile::~MemoryFile() { close(descriptor_); }

void MemoryFile::Set(absl::Span<const uint8_t> content) {
  const auto size = static_cast<ssize_t>(content.size());
  Require(ftruncate(descriptor_, 0) == 0 && pwrite(descriptor_, content.data(), size, 0) == size,
          "a file in memory takes its content");
}

}  // namespace splinemap
