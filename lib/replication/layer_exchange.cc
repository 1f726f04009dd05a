#include "lib/replication/layer_exchange.h"

#include <algorithm>
#include <utility>

#include "lcmtypes/splinemap/layer_digest_t.hpp"
#include "lcmtypes/splinemap/layer_pull_t.hpp"
#include "lcmtypes/splinemap/scan_pull_t.hpp"
#include "lib/base/status.h"

namespace splinemap {
namespace {

constexpr size_t kMaxKnownNames = 256;

}  // namespace

LayerExchange::LayerExchange(FollowOptions follow, const PublisherOptions& publisher,
                             const LayerSnapshot& own, const LayerSet& kept, Clock::time_point now)
    : publisher_options_(publisher),
      map_options_(kept.options),
      speaker_(own.session.nonce),
      takes_settings_(follow.takes_settings),
      keys_(follow.keys),
      admission_(follow.channel_prefix, keys_, speaker_),
      own_(own),
      publisher_(std::in_place, own, kept.options, publisher),
      follower_(std::move(follow),
                KeeperOptions{kept.options, own.id, own.session.number, publisher.digest_interval},
                kept, speaker_, now),
      budget_(publisher.bytes_per_s) {}

void LayerExchange::AddOwnScan(const SessionId& session, SentScan scan, Clock::time_point now) {
  if (session == own_.session) publisher_->AddScan(std::move(scan), now);
}

void LayerExchange::SetOwn(const LayerSnapshot& own, Clock::time_point now) {
  const bool is_new_session = own.id != own_.id || own.session != own_.session;
  own_ = own;
  if (!is_new_session) {
    publisher_->SetLayer(own, now);
    return;
  }
  publisher_.emplace(own, map_options_, publisher_options_);
  follower_.SetOwnLayer(own.id, own.session.number);
}

void LayerExchange::HandleBytes(absl::Span<const uint8_t> bytes, Clock::time_point now) {
  const std::optional<Admission::Message> message = admission_.Admit(bytes);
  if (message && follower_.Handle(message->content, now)) HandleAsOwner(*message, now);
}

void LayerExchange::HandleAsOwner(const Admission::Message& message, Clock::time_point now) {
  if (const auto* pull = std::get_if<layer_pull_t>(&message.content)) {
    was_called_ |= IsCall(*pull);
    const LayerRef ref = FromMessage(pull->layer);
    if (message.answers) guard_.HandleKnown(ref, OwnRef(), now);
    publisher_->HandlePull(*pull, now);
  }
  if (const auto* pull = std::get_if<scan_pull_t>(&message.content)) {
    publisher_->HandleScanPull(*pull, now);
  }
  const auto* digest = std::get_if<layer_digest_t>(&message.content);
  if (digest == nullptr) return;
  const LayerRef ref = FromMessage(digest->layer);
  if (ref.id.name == own_.id.name && ref.id != own_.id && IsOwners(*digest) &&
      known_names_.size() < kMaxKnownNames && known_names_.insert(ref.id).second) {
    duplicate_names_.push_back(ref.id);
  }
  if (ref.id != own_.id) return;
  if (!IsOwners(*digest)) {
    guard_.HandleKnown(ref, OwnRef(), now);
  } else if (ref.session < own_.session) {
    heard_earlier_session_ = true;
  } else {
    guard_.HandleDigest(ref, OwnRef(), now);
  }
}

void LayerExchange::Refill(Clock::time_point now) {
  budget_.Refill(now, publisher_->HasChanges(), publisher_->HasPulls() || follower_.HasPulls());
}

std::vector<ReplicationMessage> LayerExchange::Tick(Clock::time_point now) {
  Refill(now);
  std::vector<ReplicationMessage> messages = publisher_->Tick(now, budget_);
  std::vector<ReplicationMessage> others = follower_.Tick(now, budget_);
  std::move(others.begin(), others.end(), std::back_inserter(messages));
  return messages;
}

std::vector<ReplicationMessage> LayerExchange::LastTick(Clock::time_point now) {
  Refill(now);
  return publisher_->LastTick(now, budget_);
}

Clock::time_point LayerExchange::NextTick(Clock::time_point now) const {
  return std::min(publisher_->NextTick(now), follower_.NextTick(now));
}

absl::Status LayerExchange::Edit(const LayerId& id, Change change) {
  std::optional<SessionId> session;
  if (id == own_.id) session = own_.session;
  for (const LayerSnapshot& layer : follower_.Layers().layers) {
    if (layer.id == id) session = layer.session;
  }
  if (!session) {
    return NotFound("{} has no layer {} of origin {:016x}", own_.id.name, id.name, id.origin);
  }
  if (keys_ != nullptr && !keys_->own().decides) {
    return absl::PermissionDeniedError(fmt::format(
        "the key of {} may not decide about layers, so that nobody else would: give the command to "
        "a daemon whose key may (--robot), or let this one: splinemap keys trust .. --decides",
        own_.id.name));
  }
  LayerSettings settings = follower_.settings().Next(id, speaker_);
  // Robots that may not decide may have kept what a daemon decided that is not known here.
  settings.counter =
      std::max(settings.counter, std::min(admission_.passed_counter(),
                                          settings.counter + LayerSettings::kMaxSettingsAhead - 2) +
                                     1);
  SPLINEMAP_RETURN_IF_ERROR(change(*session, settings));
  if (!settings.IsValid()) {
    return InvalidArgument("settings of {} that cannot be", id.name);
  }
  follower_.Set(id, settings);
  if (!follower_.settings().records().contains(id)) {
    return absl::ResourceExhaustedError(
        fmt::format("{} layers have settings already, which is the most", SettingsTable::kMax));
  }
  return absl::OkStatus();
}

std::optional<SessionGuard::NextSession> LayerExchange::NextSession(Clock::time_point now,
                                                                    uint64_t random) {
  return guard_.Next(OwnRef(), now, random);
}

bool LayerExchange::IsOwnRemoved() const {
  return takes_settings_ && follower_.settings().Of(own_.id).IsRemoved(own_.session);
}

}  // namespace splinemap
