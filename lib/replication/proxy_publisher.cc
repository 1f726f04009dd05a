#include "lib/replication/proxy_publisher.h"

#include <algorithm>
#include <utility>

#include "lcmtypes/splinemap/layer_digest_t.hpp"
#include "lcmtypes/splinemap/layer_pull_t.hpp"

namespace splinemap {
namespace {

using std::chrono::milliseconds;

// Of several that could begin, one is first.
constexpr milliseconds kMaxProxyBackOff(1000);
constexpr milliseconds kMaxBackOffOfBetter(300);

}  // namespace

ProxyPublisher::ProxyPublisher(LayerFollower& copy, Clock::duration delay, uint64_t speaker,
                               const MapOptions& map_options, const PublisherOptions& options)
    : copy_(copy),
      delay_(delay),
      speaker_(speaker),
      map_options_(map_options),
      options_(options),
      random_(speaker) {
  options_.pushes = false;  // whoever follows pulls what it lacks
  options_.proxy = speaker;
}

void ProxyPublisher::HandleDigest(const layer_digest_t& digest, Clock::time_point now) {
  const auto speaker = static_cast<uint64_t>(digest.speaker);
  const LayerRef ref = FromMessage(digest.layer);
  if (speaker == speaker_ || IsOwners(digest) || ref.level_of_detail != LevelOfDetail{} ||
      !copy_.OwnerIsSilent(now))
    return;
  other_ = digest;
  other_heard_ = now;
  if (ref.session < copy_.session()) {
    BeginBy(now + random_.UpTo(kMaxBackOffOfBetter));
  } else if (!publisher_) {
    LeaveItToOthers(now);
  } else if (copy_.matches_digest() && speaker > speaker_) {
    LeaveItToOthers(now);  // one is enough
  }
}

void ProxyPublisher::LeaveItToOthers(Clock::time_point now) {
  publisher_.reset();
  due_ = now + LayerFollower::kOwnerTimeout + delay_ + random_.UpTo(kMaxProxyBackOff);
}

void ProxyPublisher::HandlePull(const layer_pull_t& pull, Clock::time_point now) {
  if (publisher_) publisher_->HandlePull(pull, now);
}

void ProxyPublisher::HandleScanPull(const scan_pull_t& pull, Clock::time_point now) {
  if (publisher_) publisher_->HandleScanPull(pull, now);
}

std::vector<ReplicationMessage> ProxyPublisher::Tick(Clock::time_point now, ByteBudget& budget,
                                                     bool may_begin) {
  std::vector<ReplicationMessage> messages;
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
    if (!due_) due_ = now + delay_ + random_.UpTo(kMaxProxyBackOff);
    if (OtherLacksSomething(now)) BeginBy(now + random_.UpTo(kMaxBackOffOfBetter));
    if (now < *due_) return messages;
  }
  const LayerSnapshot layer = copy_.Snapshot();
  if (!publisher_ || session_ != layer.session || lineage_ != layer.tiles.lineage()) {
    session_ = layer.session;
    lineage_ = layer.tiles.lineage();
    publisher_.emplace(layer, map_options_, options_, &copy_.recent_scans());
  }
  publisher_->SetLayer(layer, now);
  return publisher_->Tick(now, budget);
}

Clock::time_point ProxyPublisher::NextTick(Clock::time_point now) const {
  if (publisher_) return publisher_->NextTick(now);
  return due_ ? *due_ : copy_.last_heard() + LayerFollower::kOwnerTimeout;
}

bool ProxyPublisher::MaySpeak(Clock::time_point now) const {
  return copy_.OwnerIsSilent(now) && !copy_.ShowsPreviousSession() &&
         copy_.session() != SessionId{};
}

bool ProxyPublisher::OtherIsHeard(Clock::time_point now) const {
  return other_ && now - other_heard_ <= LayerFollower::kOwnerTimeout;
}

// The copy has all that the other one told of, and is something else: so it is newer.
bool ProxyPublisher::OtherLacksSomething(Clock::time_point now) const {
  return OtherIsHeard(now) && copy_.caught_up() && !copy_.matches_digest() &&
         static_cast<uint64_t>(other_->hash) != copy_.hash();
}

void ProxyPublisher::BeginBy(Clock::time_point latest) {
  if (!due_ || *due_ > latest) due_ = latest;
}

}  // namespace splinemap
