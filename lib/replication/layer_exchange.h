#pragma once

#include <cstdint>
#include <optional>
#include <set>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "lib/replication/admission.h"
#include "lib/replication/byte_budget.h"
#include "lib/replication/map_follower.h"
#include "lib/replication/pyramid_publisher.h"
#include "lib/replication/replication_message.h"
#include "lib/replication/session_guard.h"

namespace splinemap {

// The replication protocol of one daemon: publishes its own layer, follows those of others, is a
// proxy for silent owners, spreads settings and guards the session of its own layer, all within one
// byte budget. Without clocks, threads or sockets of its own. Thread-compatible.
class LayerExchange {
 public:
  // `own` is of a session whose nonce is the speaker of this process.
  LayerExchange(FollowOptions follow, const PublisherOptions& publisher, const LayerSnapshot& own,
                const LayerSet& kept, Clock::time_point now);

  // A scan that the own layer will have in a moment; ignored where it is of another session than
  // the present one.
  void AddOwnScan(const SessionId& session, SentScan scan, Clock::time_point now);
  // The newest state of the own layer, whatever its session.
  void SetOwn(const LayerSnapshot& own, Clock::time_point now);

  // Any bytes of ReplicationChannels(). What this process sent is ignored.
  void HandleBytes(absl::Span<const uint8_t> message, Clock::time_point now);

  // What is to be published now. Call it at NextTick().
  std::vector<ReplicationMessage> Tick(Clock::time_point now);
  // The same for an owner that leaves: what waits to be published, and a digest. Call it some times
  // a second until IsOwnKnown().
  std::vector<ReplicationMessage> LastTick(Clock::time_point now);
  // Whether followers, on a lossy bus too, had time to get the own layer as it is.
  bool IsOwnKnown(Clock::time_point now) const { return publisher_->IsKnown(now); }
  // When Tick() will have something to do, if nothing comes before.
  Clock::time_point NextTick(Clock::time_point now) const;

  // Changes the settings of a layer that is here, its own too, in one step, by what `change` makes
  // of the newest ones. Its errors; NotFound; InvalidArgument for settings that cannot be;
  // ResourceExhausted where too many layers have settings; PermissionDenied where there are keys
  // and others would not take it from this computer's. After an error nothing is changed.
  using Change = absl::FunctionRef<absl::Status(const SessionId& session, LayerSettings& settings)>;
  absl::Status Edit(const LayerId& id, Change change);

  // The session that the own layer has to start now, random bits for a new origin given; nothing
  // where all is well. It is asked for again until SetOwn() has one that fits.
  std::optional<SessionGuard::NextSession> NextSession(Clock::time_point now, uint64_t random);
  // Whether somebody removed the own layer, so that it has to start an empty session.
  bool IsOwnRemoved() const;

  // Since it was drained last: somebody asked who is there; an earlier session of the own layer was
  // on the bus; layers of its name.
  bool DrainCall() { return std::exchange(was_called_, false); }
  bool DrainEarlierSession() { return std::exchange(heard_earlier_session_, false); }
  std::vector<LayerId> DrainDuplicateNames() { return std::exchange(duplicate_names_, {}); }

  const MapFollower& follower() const { return follower_; }
  LayerSet FollowedLayers() { return follower_.Layers(); }
  // What became of messages.
  const Admission& admission() const { return admission_; }
  // Those that are damaged, of another type, or of sessions that nobody can have.
  int64_t malformed() const { return admission_.malformed() + follower_.malformed(); }

 private:
  LayerRef OwnRef() const { return {own_.id, own_.session, {}}; }
  void HandleAsOwner(const Admission::Message& message, Clock::time_point now);
  void Refill(Clock::time_point now);

  const PublisherOptions publisher_options_;
  const MapOptions map_options_;
  const uint64_t speaker_;
  const bool takes_settings_;
  const std::shared_ptr<const KeyRing> keys_;
  Admission admission_;
  LayerSnapshot own_;
  std::optional<PyramidPublisher> publisher_;  // always; of the present session
  MapFollower follower_;
  SessionGuard guard_;
  ByteBudget budget_;
  bool was_called_ = false;
  bool heard_earlier_session_ = false;
  std::set<LayerId> known_names_;  // layers of the own name that were reported
  std::vector<LayerId> duplicate_names_;
};

}  // namespace splinemap
