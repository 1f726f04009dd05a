#include "lib/replication/stand_in.h"

#include <algorithm>
#include <utility>

namespace splinemap {
namespace {

using std::chrono::milliseconds;

// Of several that could begin, one is first.
constexpr milliseconds kMaxStandInBackOff(1000);
constexpr milliseconds kMaxBackOffOfBetter(300);

}  // namespace

StandIn::StandIn(LayerFollower& copy, Clock::duration patience, uint64_t nonce,
                 const MapOptions& map_options, const PublisherOptions& options)
    : copy_(copy),
      patience_(patience),
      nonce_(nonce),
      map_options_(map_options),
      options_(options),
      random_(nonce) {
  options_.pushes = false;  // whoever follows pulls what it lacks
}

void StandIn::TakeDigest(const stand_in_digest_t& other, Clock::time_point now) {
  const auto nonce = static_cast<uint64_t>(other.daemon_nonce);
  const LayerLife life = FromMessage(other.digest.layer);
  if (nonce == nonce_ || life.detail != Detail{} || !copy_.OwnerIsSilent(now)) return;
  other_ = other;
  other_heard_ = now;
  if (life.epoch < copy_.epoch()) {
    BeginBy(now + random_.UpTo(kMaxBackOffOfBetter));
  } else if (!publisher_) {
    LeaveItToOthers(now);
  } else if (copy_.is_equal() && nonce > nonce_) {
    LeaveItToOthers(now);  // one is enough
  }
}

void StandIn::LeaveItToOthers(Clock::time_point now) {
  publisher_.reset();
  due_ = now + LayerFollower::kMaxSilence + patience_ + random_.UpTo(kMaxStandInBackOff);
}

void StandIn::TakePull(const layer_pull_t& pull, Clock::time_point now) {
  if (publisher_) publisher_->TakePull(pull, now);
}

std::vector<StandIn::Message> StandIn::Tick(Clock::time_point now, bool may_begin) {
  std::vector<Message> messages;
  if (!MaySpeak(now)) {
    publisher_.reset();
    due_.reset();
    other_.reset();
    return messages;
  }
  if (!may_begin && !OtherIsHeard(now)) {
    publisher_.reset();
    due_.reset();
    return messages;
  }
  if (!publisher_) {
    if (!due_) due_ = now + patience_ + random_.UpTo(kMaxStandInBackOff);
    if (OtherLacksSomething(now)) BeginBy(now + random_.UpTo(kMaxBackOffOfBetter));
    if (now < *due_) return messages;
  }
  const LayerSnapshot layer = copy_.Snapshot();
  if (!publisher_ || epoch_ != layer.epoch || line_ != layer.tiles.line()) {
    epoch_ = layer.epoch;
    line_ = layer.tiles.line();
    publisher_.emplace(layer, map_options_, options_);
  }
  publisher_->SetLayer(layer, now);
  for (const PublishedMessage& message : publisher_->Tick(now)) {
    if (const auto* digest = std::get_if<layer_digest_t>(&message)) {
      stand_in_digest_t stand_in;
      stand_in.daemon_nonce = static_cast<int64_t>(nonce_);
      stand_in.digest = *digest;
      messages.emplace_back(std::move(stand_in));
    } else if (const auto* listing = std::get_if<layer_listing_t>(&message)) {
      messages.emplace_back(*listing);
    } else {
      messages.emplace_back(std::get<layer_updates_t>(message));
    }
  }
  return messages;
}

bool StandIn::MaySpeak(Clock::time_point now) const {
  return copy_.OwnerIsSilent(now) && !copy_.ShowsPreviousLife() && copy_.epoch() != LayerEpoch{};
}

bool StandIn::OtherIsHeard(Clock::time_point now) const {
  return other_ && now - other_heard_ <= LayerFollower::kMaxSilence;
}

// The copy has all that the other one told of, and is something else: so it is newer.
bool StandIn::OtherLacksSomething(Clock::time_point now) const {
  return OtherIsHeard(now) && copy_.in_sync() && !copy_.is_equal() &&
         static_cast<uint64_t>(other_->digest.hash) != copy_.hash();
}

void StandIn::BeginBy(Clock::time_point latest) {
  if (!due_ || *due_ > latest) due_ = latest;
}

}  // namespace splinemap
