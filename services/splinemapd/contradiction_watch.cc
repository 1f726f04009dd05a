#include "services/splinemapd/contradiction_watch.h"

#include <algorithm>

namespace splinemap {

bool ContradictionWatch::Check(NewestMap& newest) {
  const Clock::time_point begin = Clock::now();
  if (begin < earliest_) return false;
  auto set = newest.Layers();
  if (set == compared_) return false;
  const bool has_new_settings =
      compared_ != nullptr && set->settings.hash() != compared_->settings.hash();
  if (begin < due_ && !has_new_settings) return false;
  compared_ = std::move(set);
  // A layer alone has nothing to contradict, and nobody may need the sum.
  contradictions_.clear();
  if (compared_->layers.size() > 1) {
    contradictions_ = ContradictionsOf(*compared_, *newest.View());
  }
  const Clock::time_point end = Clock::now();
  earliest_ = end + 100 * (end - begin);
  due_ = std::max(end + kInterval, earliest_);
  return true;
}

}  // namespace splinemap
