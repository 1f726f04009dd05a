#include "services/splinemapd/replication_thread.h"

#include <algorithm>
#include <utility>

#include "absl/hash/hash.h"
#include "lcmtypes/splinemap/layer_digest_t.hpp"
#include "lib/base/random.h"
#include "lib/base/status.h"
#include "lib/wire/decode.h"
#include "lib/wire/encode.h"
#include "lib/wire/message_type.h"

namespace splinemap {
namespace {

using std::chrono::milliseconds;

constexpr size_t kMaxQueuedBytes = size_t{16} << 20;
// What one commit changed comes in several messages, which are published together.
constexpr milliseconds kBatch(10);
// How often the session is checked, and how soon tried again where a new one cannot be saved.
constexpr milliseconds kSessionInterval(500);
constexpr milliseconds kReportInterval(450);
constexpr milliseconds kMaxFarewell(5000);
constexpr milliseconds kFarewellInterval(50);
constexpr size_t kMaxHeardDigests = 4096;

}  // namespace

ReplicationThread::ReplicationThread(LcmBus& bus, const FollowOptions& follow,
                                     const PublisherOptions& publisher, const LayerSet& kept,
                                     NewestMap& newest, NoticeLog& notices)
    : bus_(bus),
      channel_prefix_(follow.channel_prefix),
      keys_(follow.keys),
      speaker_(newest.Own().session.nonce),
      newest_(newest),
      notices_(notices),
      mailbox_(kMaxQueuedBytes),
      exchange_(follow, publisher, newest.Own(), kept, Clock::now()) {
  UseNewest();
  UpdateReport(Clock::now());
}

void ReplicationThread::Start(StartSession start_session) {
  start_session_ = std::move(start_session);
  replicating_ = std::jthread([this](const std::stop_token& stop) { Run(stop); });
}

void ReplicationThread::Handle(absl::Span<const uint8_t> message) {
  if (SpeakerOf(message) == speaker_) return;  // its own, which multicast brings back
  mailbox_.Push("", message, Utime(0), IsNews(message));
}

// Most of what an idle fleet says are digests that were heard before. They have time until the
// thread wakes for itself, twice a second.
bool ReplicationThread::IsNews(absl::Span<const uint8_t> message) {
  if (TypeOf(message) != MessageType::kLayerDigest) return true;
  absl::StatusOr<layer_digest_t> digest = Decode<layer_digest_t>(message);
  if (!digest.ok()) return true;
  digest->utime = 0;
  MutexLock lock(mutex_);
  if (heard_digests_.size() >= kMaxHeardDigests) heard_digests_.clear();
  return heard_digests_.insert(absl::HashOf(Encode(*digest))).second;
}

void ReplicationThread::OnOwnScan(SessionId session, SentScan scan) {
  {
    MutexLock lock(mutex_);
    own_scans_.emplace_back(session, std::move(scan));
  }
  mailbox_.Post([this] { AddOwnScans(); });
}

void ReplicationThread::AddOwnScans() {
  std::vector<std::pair<SessionId, SentScan>> scans;
  {
    MutexLock lock(mutex_);
    scans = std::exchange(own_scans_, {});
  }
  for (auto& [session, scan] : scans) {
    exchange_.AddOwnScan(session, std::move(scan), Clock::now());
  }
}

// The scans of a state come before it, whichever task is first.
void ReplicationThread::UseOwn() {
  const LayerSnapshot own = newest_.Own();
  AddOwnScans();
  exchange_.SetOwn(own, Clock::now());
}

void ReplicationThread::OnOwnChange() {
  if (is_own_changed_.exchange(true)) return;
  mailbox_.Post([this] {
    is_own_changed_ = false;
    UseOwn();
  });
}

void ReplicationThread::Edit(LayerId id, Change change, Done done) {
  mailbox_.Post([=, this, id = std::move(id), change = std::move(change), done = std::move(done)] {
    const absl::Status status = exchange_.Edit(id, change);
    UseNewest();
    if (status.ok() && exchange_.IsOwnRemoved() && !is_starting_) {
      StartAfterRemoval(done);
    } else {
      done(status);
    }
  });
}

void ReplicationThread::Run(const std::stop_token& stop) {
  while (true) {
    auto item = mailbox_.Pop(stop, exchange_.NextTick(Clock::now()));
    if (!item && stop.stop_requested()) break;
    for (const auto end = Clock::now() + kBatch; item; item = mailbox_.TryPop()) {
      HandleItem(*item);
      if (Clock::now() >= end) break;
    }
    const Clock::time_point now = Clock::now();
    Publish(exchange_.Tick(now));
    UseNewest();
    CheckSession(now);
    UpdateReport(now);
  }
  SayLast();
}

// What was mapped last may have been lost by every follower, and nobody can ask for it later.
void ReplicationThread::SayLast() {
  UseOwn();
  next_report_ = {};
  UpdateReport(Clock::now());
  const auto deadline = Clock::now() + kMaxFarewell;
  while (true) {
    Publish(exchange_.LastTick(Clock::now()));
    const auto next = Clock::now() + kFarewellInterval;
    while (auto item = mailbox_.Pop({}, next)) HandleItem(*item);
    if (exchange_.IsOwnKnown(next) || next >= deadline) return;
  }
}

void ReplicationThread::HandleItem(const Mailbox::Item& item) {
  if (const auto* task = std::get_if<Task>(&item)) (*task)();
  if (const auto* message = std::get_if<MailboxMessage>(&item)) {
    exchange_.HandleBytes(message->bytes, Clock::now());
  }
}

void ReplicationThread::UseNewest() {
  const MapFollower& follower = exchange_.follower();
  if (std::exchange(used_version_, follower.version() + 1) == follower.version() + 1) return;
  newest_.SetFollowed(exchange_.FollowedLayers().layers, follower.LastingSettings());
}

void ReplicationThread::CheckSession(Clock::time_point now) {
  if (is_starting_ || now < next_session_check_) return;
  next_session_check_ = now + kSessionInterval;
  if (exchange_.IsOwnRemoved()) {
    StartAfterRemoval({});
    return;
  }
  const LayerSnapshot own = newest_.Own();
  const std::string& name = own.id.name;
  const auto next = exchange_.NextSession(now, RandomId());
  if (!next) return;
  const std::string text =
      next->is_other_layer
          ? fmt::format(
                "a later session of {} is on the bus: another splinemapd has a copy of this "
                "map file, or a log of one is replayed. This splinemapd continues as another "
                "layer, origin {:016x}; data mapped before the file was copied is counted "
                "twice by those who follow both",
                name, next->ref.id.origin)
          : fmt::format(
                "followers know a later session of {} than session {}: the map file is an "
                "older copy. It continues as session {}, and followers take that for the map",
                name, own.session.number, next->ref.session.number);
  StartNewSession(next->ref.id, next->ref.session, /*is_empty=*/false,
                  [=, this] { notices_.ReportProblem(Problem::kSharedIdentity, "later", text); },
                  "another session of this layer is on the bus, and no new one can be saved", {});
}

void ReplicationThread::StartAfterRemoval(Done done) {
  const LayerId own = newest_.Own().id;
  const SessionId next{exchange_.follower().settings().Of(own).removed_up_to + 1, speaker_};
  StartNewSession(
      own, next, /*is_empty=*/true,
      [=, this] {
        notices_.Report({.subject = "removed",
                         .text = fmt::format("layer {} was removed by a command; it "
                                             "starts empty, in session {}",
                                             own.name, next.number)});
      },
      "this layer was removed by a command, and its empty session cannot be saved",
      std::move(done));
}

void ReplicationThread::StartNewSession(LayerId id, SessionId session, bool is_empty,
                                        std::function<void()> on_success,
                                        const std::string& failure, Done done) {
  is_starting_ = true;
  start_session_(std::move(id), session, is_empty, [=, this](const absl::Status& started) {
    if (started.ok()) {
      on_success();
    } else {
      notices_.Report({.subject = "session", .text = failure + ": " + ErrorText(started)});
    }
    mailbox_.Post([=, this] {
      UseOwn();
      is_starting_ = false;
      if (done) done(started);
    });
  });
}

void ReplicationThread::Publish(const std::vector<ReplicationMessage>& messages) {
  for (const ReplicationMessage& message : messages) {
    const std::string channel = ChannelOf(message, channel_prefix_);
    bus_.PublishBytes(channel, Signed(keys_.get(), channel, EncodeReplication(message)));
  }
}

void ReplicationThread::UpdateReport(Clock::time_point now) {
  const bool was_called = exchange_.DrainCall();
  if (now < next_report_ && !was_called) return;
  next_report_ = now + kReportInterval;
  const MapFollower& follower = exchange_.follower();
  MutexLock lock(mutex_);
  report_.followed = follower.FollowedLayers(now);
  report_.refused = follower.refused();
  report_.settings_hash = follower.settings().hash();
  report_.is_full = follower.is_full();
  report_.was_called |= was_called;
  report_.heard_earlier_session |= exchange_.DrainEarlierSession();
  for (const LayerId& id : exchange_.DrainDuplicateNames()) report_.same_names.push_back(id);
  report_.refused_settings = follower.refused_settings();
  report_.ignored_settings = follower.ignored_settings();
  report_.malformed = exchange_.malformed();
  report_.disbelieved = exchange_.admission().disbelieved();
  report_.believed = exchange_.admission().believed();
  report_.dropped = mailbox_.dropped();
}

ReplicationThread::Report ReplicationThread::DrainReport() {
  MutexLock lock(mutex_);
  Report report = report_;
  report_.was_called = false;
  report_.heard_earlier_session = false;
  report_.same_names.clear();
  return report;
}

void ReplicationThread::Stop() {
  replicating_.request_stop();
  if (replicating_.joinable()) replicating_.join();
}

}  // namespace splinemap
