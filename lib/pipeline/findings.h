#pragma once

#include <string>

#include "lib/pipeline/notice.h"
#include "lib/sensing/drop_counts.h"

namespace splinemap {

// What was dropped and what is wrong: counts since construction, and notices of it.
// Thread-compatible.
struct Findings {
  void Drop(DropReason reason, const std::string& channel, const std::string& explanation);
  void Find(Problem problem, const std::string& channel, const std::string& text);

  DropCounts drops;
  ProblemCounts problems{};
  NoticeList notices;
};

}  // namespace splinemap
