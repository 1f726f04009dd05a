#include "services/splinemapd/contradiction_watch.h"

#include <algorithm>

namespace splinemap {

bool ContradictionWatch::Check(NewestMap& newest) {
  const Clock::time_point begin = Clock::now();
  if (begin < due_) return false;
  auto set = newest.Layers();
  if (set == compared_) return false;
  compared_ = std::move(set);
  // A layer alone has nothing to contradict, and nobody may need the sum.
  contradictions_.clear();
  if (compared_->layers.size() > 1) {
    contradictions_ = ContradictionsOf(*compared_, *newest.View());
  }
  const Clock::time_point end = Clock::now();
  due_ = end + std::max<Clock::duration>(kInterval, 100 * (end - begin));
  return true;
}

}  // namespace splinemap
