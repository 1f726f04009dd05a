#pragma once

#include <atomic>
#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include "absl/container/flat_hash_set.h"
#include "absl/status/status.h"
#include "absl/types/span.h"
#include "lib/base/mutex.h"
#include "lib/replication/layer_exchange.h"
#include "lib/wire/lcm_bus.h"
#include "services/splinemapd/mailbox.h"
#include "services/splinemapd/newest_map.h"
#include "services/splinemapd/notice_log.h"

namespace splinemap {

// Owns the daemon's LayerExchange: publishes its layer and follows others, in a thread of its own,
// so that neither the map nor what is received waits for followers. Thread-safe.
class ReplicationThread {
 public:
  using Done = std::function<void(const absl::Status&)>;
  using Change = std::function<absl::Status(const SessionId& session, LayerSettings& settings)>;
  // Has the own layer continue in another session; see MappingThread.
  using StartSession = std::function<void(LayerId id, SessionId session, bool is_empty, Done done)>;

  // The others outlive it. Begins with the layers of others and the settings of `kept`.
  ReplicationThread(LcmBus& bus, const FollowOptions& follow, const PublisherOptions& publisher,
                    const LayerSet& kept, NewestMap& newest, NoticeLog& notices);

  void Start(StartSession start_session);

  // Any bytes on ReplicationChannels(). Does not wait; when too many wait, the oldest are dropped
  // and counted: followers ask again.
  void Handle(absl::Span<const uint8_t> message);

  // A scan is about to be mapped into the own layer.
  void OnOwnScan(SessionId session, SentScan scan);

  // The newest map has a new state of the own layer.
  void OnOwnChange();

  // As LayerExchange::Edit(), for `done` in the thread.
  void Edit(LayerId id, Change change, Done done);

  // For status messages; at most half a second old while the thread runs, and no older than a call.
  struct Report {
    std::vector<FollowedLayer> followed;
    std::vector<std::string> refused;
    uint64_t settings_hash = 0;
    bool is_full = false;
    // Since the last report.
    bool was_called = false;             // somebody asked who is there
    bool heard_earlier_session = false;  // of the own layer
    std::vector<LayerId> same_names;     // other layers of the own name
    // In all.
    int64_t refused_settings = 0;  // that nobody can have made
    int64_t ignored_settings = 0;  // that are not taken here
    int64_t malformed = 0;         // messages
    std::map<absl::StatusCode, Admission::Disbelieved> disbelieved;
    int64_t believed = 0;  // messages that are signed as they should be
    int64_t dropped = 0;   // messages that came faster than they were handled
  };
  Report DrainReport();
  const WorkSteps& steps() { return mailbox_.steps(); }

  // Publishes the own layer as it is last, until followers had time to ask for what they lack, and
  // ends the thread: 0.3 s after a change where nobody lacks anything, and 5 s at most.
  void Stop();

 private:
  void Run(const std::stop_token& stop);
  void SayLast();
  bool IsNews(absl::Span<const uint8_t> message);
  void HandleItem(const Mailbox::Item& item);
  void CheckSession(Clock::time_point now);
  void StartNewSession(LayerId id, SessionId session, bool is_empty,
                       std::function<void()> on_success, const std::string& failure, Done done);
  void StartAfterRemoval(Done done);
  void AddOwnScans();
  void UseOwn();
  void UseNewest();
  void Publish(const std::vector<ReplicationMessage>& messages);
  void UpdateReport(Clock::time_point now);

  LcmBus& bus_;
  const std::string channel_prefix_;
  const std::shared_ptr<const KeyRing> keys_;
  const uint64_t speaker_;
  NewestMap& newest_;
  NoticeLog& notices_;
  StartSession start_session_;
  Mailbox mailbox_;
  std::atomic<bool> is_own_changed_ = false;
  // Of the thread, while it runs.
  LayerExchange exchange_;
  uint64_t used_version_ = 0;  // of the followed layers in newest_
  bool is_starting_ = false;   // a session
  Clock::time_point next_session_check_;
  Clock::time_point next_report_;
  Mutex mutex_;
  Report report_ ABSL_GUARDED_BY(mutex_);
  std::vector<std::pair<SessionId, SentScan>> own_scans_ ABSL_GUARDED_BY(mutex_);  // to be sent
  absl::flat_hash_set<size_t> heard_digests_ ABSL_GUARDED_BY(mutex_);  // hashes, without utime
  std::jthread replicating_;
};

}  // namespace splinemap
