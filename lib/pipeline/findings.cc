#include "lib/pipeline/findings.h"

#include "fmt/format.h"

namespace splinemap {

void Findings::Drop(DropReason reason, const std::string& channel, const std::string& explanation) {
  ++drops[reason];
  notices.Add(true, fmt::format("{} {}", DropName(reason), channel),
              fmt::format("dropped {} on {}: {}", DropName(reason), channel, explanation));
}

void Findings::Find(Problem problem, const std::string& channel, const std::string& text) {
  ++problems[static_cast<int>(problem)];
  notices.Add(true, fmt::format("{} {}", ProblemName(problem), channel),
              fmt::format("{}: {}", channel, text));
}

}  // namespace splinemap
