#include "lib/replication/session_guard.h"

#include "splinemap/layer_settings.h"

namespace splinemap {
namespace {

using std::chrono::milliseconds;

// An owner that is there is heard again within this time, and so are followers that ask for it.
constexpr milliseconds kMaxOwnerSilence(3500);
// Digests over such a time are no single mistake.
constexpr milliseconds kMinPresence(1500);
// Followers that heard of a later session by mistake have given it up by then.
constexpr milliseconds kMinKnown(5000);

bool IsLater(const LayerRef& heard, const LayerRef& own) {
  return heard.id == own.id && heard.session > own.session;
}

}  // namespace

void SessionGuard::HandleDigest(const LayerRef& heard, const LayerRef& own, Clock::time_point now) {
  if (IsLater(heard, own)) Remember(other_owner_, heard, now);
}

void SessionGuard::HandleKnown(const LayerRef& heard, const LayerRef& own, Clock::time_point now) {
  if (IsLater(heard, own)) Remember(known_, heard, now);
}

void SessionGuard::Remember(std::optional<Heard>& heard, const LayerRef& ref,
                            Clock::time_point now) {
  if (!heard || heard->ref.id != ref.id || now - heard->last > kMaxOwnerSilence) {
    heard = Heard{ref, now, now};
  }
  if (heard->ref.session < ref.session) heard->ref = ref;
  heard->last = now;
}

std::optional<SessionGuard::NextSession> SessionGuard::Next(const LayerRef& own,
                                                            Clock::time_point now,
                                                            uint64_t random) {
  // What was heard of before the session that is there now, and what nobody speaks of any more.
  for (std::optional<Heard>* heard : {&other_owner_, &known_}) {
    if (*heard && (!IsLater((*heard)->ref, own) || now - (*heard)->last > kMaxOwnerSilence)) {
      heard->reset();
    }
  }
  const auto is_heard_for = [](const std::optional<Heard>& heard, milliseconds duration) {
    return heard && heard->last - heard->since >= duration;
  };
  const bool has_other_owner = is_heard_for(other_owner_, kMinPresence);
  if (!has_other_owner && !is_heard_for(known_, kMinKnown)) return std::nullopt;
  NextSession next{own, false};
  const uint64_t heard = known_ ? known_->ref.session.number : 0;
  if (has_other_owner || heard > own.session.number + LayerSettings::kMaxSessionsAhead) {
    next.is_other_layer = true;
    next.ref.id.origin = random;
    next.ref.session.number = 1;
    other_owner_.reset();
    known_.reset();
  } else {
    next.ref.session.number = heard + 1;
  }
  return next;
}

}  // namespace splinemap
