#pragma once

#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "services/splinemapd/work_steps.h"

namespace splinemap {

// Finds threads that hang. It only looks: a thread is never woken to say that it is alive.
// Thread-compatible.
class ThreadWatch {
 public:
  // `steps` outlives it.
  void Add(std::string name, const WorkSteps& steps) {
    watched_.push_back({std::move(name), &steps, std::nullopt});
  }

  // The first thread that has been at one step of its work since the last call.
  std::optional<std::string> FindHanging() {
    std::optional<std::string> hanging;
    for (Watched& watched : watched_) {
      const int64_t count = watched.steps->count();
      const bool is_waiting = count % 2 != 0;
      const bool got_on = std::exchange(watched.last_count, count) != count;
      if (!is_waiting && !got_on && !hanging) hanging = watched.name;
    }
    return hanging;
  }

 private:
  struct Watched {
    std::string name;
    const WorkSteps* steps;
    std::optional<int64_t> last_count;
  };
  std::vector<Watched> watched_;
};

}  // namespace splinemap
