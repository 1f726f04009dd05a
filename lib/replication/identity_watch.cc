#include "lib/replication/identity_watch.h"

#include <algorithm>
#include <limits>

namespace splinemap {
namespace {

// In this time an owner that is there is heard.
constexpr std::chrono::milliseconds kMaxSilence(3000);

}  // namespace

void IdentityWatch::TakeDigest(const LayerLife& heard, const LayerLife& own) {
  if (heard.id != own.id || heard.epoch <= own.epoch) return;
  other_owner_ = std::max(other_owner_.value_or(heard.epoch), heard.epoch);
}

void IdentityWatch::TakePull(const LayerLife& heard, const LayerLife& own, Clock::time_point now) {
  if (heard.id != own.id || heard.epoch <= own.epoch) return;
  if (!asked_for_) since_ = now;
  asked_for_ = std::max(asked_for_.value_or(heard.epoch), heard.epoch);
}

std::optional<IdentityWatch::NextLife> IdentityWatch::Next(const LayerLife& own,
                                                           Clock::time_point now, uint64_t random) {
  // Both are of before the life that is there now.
  if (other_owner_ && *other_owner_ <= own.epoch) other_owner_.reset();
  if (asked_for_ && *asked_for_ <= own.epoch) asked_for_.reset();

  const bool is_older_copy = asked_for_ && now - since_ >= kMaxSilence;
  if (!other_owner_ && !is_older_copy) return std::nullopt;
  NextLife next{own, false};
  next.life.epoch.nonce = random;
  const uint64_t heard = asked_for_ ? asked_for_->incarnation : 0;
  if (other_owner_ || heard == std::numeric_limits<uint64_t>::max()) {
    next.is_other_layer = true;
    next.life.id.origin = random;
    next.life.epoch.incarnation = 1;
    other_owner_.reset();
    asked_for_.reset();
  } else {
    next.life.epoch.incarnation = heard + 1;
  }
  return next;
}

}  // namespace splinemap
