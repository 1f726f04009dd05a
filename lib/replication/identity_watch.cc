#include "lib/replication/identity_watch.h"

namespace splinemap {
namespace {

// In this time an owner that is there is heard.
constexpr std::chrono::milliseconds kMaxSilence(3000);

bool IsLater(const LayerLife& heard, const LayerLife& own) {
  return heard.id == own.id && heard.epoch > own.epoch;
}

}  // namespace

void IdentityWatch::TakeDigest(const LayerLife& heard, const LayerLife& own) {
  if (IsLater(heard, own)) Remember(other_owner_, heard);
}

void IdentityWatch::TakePull(const LayerLife& heard, const LayerLife& own, Clock::time_point now) {
  if (!IsLater(heard, own)) return;
  if (!asked_for_) since_ = now;
  Remember(asked_for_, heard);
}

void IdentityWatch::Remember(std::optional<LayerLife>& greatest, const LayerLife& heard) {
  if (!greatest || greatest->id != heard.id || greatest->epoch < heard.epoch) greatest = heard;
}

std::optional<IdentityWatch::NextLife> IdentityWatch::Next(const LayerLife& own,
                                                           Clock::time_point now, uint64_t random) {
  // What was heard of before the life that is there now.
  for (std::optional<LayerLife>* heard : {&other_owner_, &asked_for_}) {
    if (*heard && !IsLater(**heard, own)) heard->reset();
  }
  const bool is_older_copy = asked_for_ && now - since_ >= kMaxSilence;
  if (!other_owner_ && !is_older_copy) return std::nullopt;
  NextLife next{own, false};
  next.life.epoch.nonce = random;
  const uint64_t heard = asked_for_ ? asked_for_->epoch.incarnation : 0;
  if (other_owner_ || heard >= LayerEpoch::kMaxIncarnation) {
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
