#include "lib/replication/identity_watch.h"

#include "lib/map/layer_control.h"

namespace splinemap {
namespace {

using std::chrono::milliseconds;

// An owner that is there is heard again within this time, and so are followers that ask for it.
constexpr milliseconds kMaxOwnerSilence(3500);
// Digests over such a time are no single mistake.
constexpr milliseconds kMinPresence(1500);
// Followers that heard of a later life by mistake have given it up by then.
constexpr milliseconds kMinAsking(5000);

bool IsLater(const LayerLife& heard, const LayerLife& own) {
  return heard.id == own.id && heard.epoch > own.epoch;
}

}  // namespace

void IdentityWatch::TakeDigest(const LayerLife& heard, const LayerLife& own,
                               Clock::time_point now) {
  if (IsLater(heard, own)) Remember(other_owner_, heard, now);
}

void IdentityWatch::TakePull(const LayerLife& heard, const LayerLife& own, Clock::time_point now) {
  if (IsLater(heard, own)) Remember(asked_for_, heard, now);
}

void IdentityWatch::Remember(std::optional<Heard>& heard, const LayerLife& life,
                             Clock::time_point now) {
  if (!heard || heard->life.id != life.id || now - heard->last > kMaxOwnerSilence) {
    heard = Heard{life, now, now};
  }
  if (heard->life.epoch < life.epoch) heard->life = life;
  heard->last = now;
}

std::optional<IdentityWatch::NextLife> IdentityWatch::Next(const LayerLife& own,
                                                           Clock::time_point now, uint64_t random) {
  // What was heard of before the life that is there now, and what nobody speaks of any more.
  for (std::optional<Heard>* heard : {&other_owner_, &asked_for_}) {
    if (*heard && (!IsLater((*heard)->life, own) || now - (*heard)->last > kMaxOwnerSilence)) {
      heard->reset();
    }
  }
  const auto is_heard_for = [](const std::optional<Heard>& heard, milliseconds duration) {
    return heard && heard->last - heard->since >= duration;
  };
  const bool has_other_owner = is_heard_for(other_owner_, kMinPresence);
  if (!has_other_owner && !is_heard_for(asked_for_, kMinAsking)) return std::nullopt;
  NextLife next{own, false};
  next.life.epoch.nonce = random;
  const uint64_t heard = asked_for_ ? asked_for_->life.epoch.incarnation : 0;
  if (has_other_owner || heard > own.epoch.incarnation + LayerControl::kMaxStartsAhead) {
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
