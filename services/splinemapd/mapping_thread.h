#pragma once

#include <chrono>
#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <thread>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/types/span.h"
#include "lib/base/host_clock.h"
#include "lib/base/mutex.h"
#include "lib/config/config.h"
#include "lib/pipeline/mapper.h"
#include "services/splinemapd/folded_layer.h"
#include "services/splinemapd/mailbox.h"
#include "services/splinemapd/map_saver.h"
#include "services/splinemapd/newest_map.h"
#include "services/splinemapd/notice_log.h"

namespace splinemap {

// Owns the daemon's layer: maps scans and poses into it, in a thread of its own. Thread-safe.
class MappingThread {
 public:
  using Done = std::function<void(const absl::Status&)>;

  // The others outlive it. `on_change` is called by the thread when the newest map has a new state
  // of the own layer.
  MappingThread(const config::Config& config, const MapOptions& map_options, Layer layer,
                ScanArchive archive, NewestMap& newest, MapSaver& saver, NoticeLog& notices);

  // The channels of scans, poses and extrinsics.
  const std::vector<std::string>& channels() const { return mapper_.channels(); }

  // Is told of each scan before it is mapped into a layer of that session, for which it makes the
  // commit `revision`.
  using OnScan = std::function<void(const SessionId& session, uint64_t revision,
                                    const FixedPose2& layer_T_robot, const PackedScan& scan)>;
  void Start(std::function<void()> on_change, OnScan on_scan);

  // A message of channels(). Does not wait; when too many wait, the oldest are dropped and counted.
  void Handle(const std::string& channel, absl::Span<const uint8_t> message) {
    mailbox_.Push(channel, message, Utime(HostUtime()));
  }

  // Continues the layer in another session, or as another layer, after that is on disk; without its
  // tiles where `is_empty`. `done` runs in the thread. After an error all is as before.
  void StartSession(LayerId id, SessionId session, bool is_empty, Done done);

  // Continues as a layer that was made anew, with the scans that came meanwhile: in another
  // session, after that is on disk, or in the same one where no tile differs. Aborted where the
  // layer is in another session than that one was made of. `done` gets in words what has changed.
  using TookOver = std::function<void(absl::StatusOr<std::string>)>;
  void TakeOver(std::unique_ptr<FoldedLayer> layer, TookOver done);

  // Keeps so many bytes of scans at most from now on.
  void LimitArchive(size_t max_bytes);
  // Why no scan is mapped any more; empty: they are.
  void Refuse(std::string why);

  // What has been mapped, for status messages.
  struct State {
    MapperCounts counts;
    size_t messages_queued = 0;
    size_t scans_queued = 0;
    Utime newest_scan_utime{0};
    std::optional<Clock::time_point> last_mapped;
    // Since the last call of DrainState().
    int64_t scans = 0;
    std::chrono::nanoseconds scan_time{0};
    std::chrono::nanoseconds longest_scan_time{0};
  };
  State DrainState();
  // Messages that came faster than they were mapped.
  int64_t dropped() const { return mailbox_.dropped(); }
  const WorkSteps& steps() { return mailbox_.steps(); }

  // Maps what was received and can be placed, and ends the thread.
  void Stop();

 private:
  void Run(const std::stop_token& stop);
  void MapMessage(const MailboxMessage& message);
  void PublishState();
  absl::Status SaveSession(const LayerSnapshot& own);
  absl::StatusOr<std::string> TakeOverNow(FoldedLayer& layer);

  NewestMap& newest_;
  MapSaver& saver_;
  NoticeLog& notices_;
  Mailbox mailbox_;
  std::function<void()> on_change_;
  // Of the thread, while it runs.
  Layer layer_;
  Mapper mapper_;
  State unpublished_;

  Mutex mutex_;
  State state_ ABSL_GUARDED_BY(mutex_);
  std::jthread mapping_;
};

}  // namespace splinemap
