#pragma once

#include <chrono>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <thread>
#include <vector>

#include "absl/container/flat_hash_set.h"
#include "absl/status/statusor.h"
#include "absl/types/span.h"
#include "lib/config/config.h"
#include "lib/mapping/archive_edit.h"
#include "lib/wire/trajectory_parts.h"
#include "services/splinemapd/mailbox.h"
#include "services/splinemapd/mapping_thread.h"
#include "services/splinemapd/newest_map.h"
#include "services/splinemapd/notice_log.h"
#include "splinemap/key_ring.h"

namespace splinemap {

// Makes the own layer anew from its scans where their poses, its placement or what is to be
// forgotten have changed, in a thread of its own, while mapping goes on. The new layer takes over
// in one commit, as another session. Thread-safe.
class FoldingThread {
 public:
  using Done = std::function<void(const absl::Status&)>;
  using EditOf = std::function<absl::StatusOr<ArchiveEdit>(const ScanArchive&)>;

  // The others outlive it. With keys, trajectories are taken that are signed by who maps the own
  // layer or decides.
  FoldingThread(const config::Config& config, std::shared_ptr<const KeyRing> keys,
                const MapOptions& options, std::shared_ptr<TileMemory> memory, NewestMap& newest,
                MappingThread& mapping, NoticeLog& notices);

  void Start();

  // Does not wait. `what` says for people what is done: "placed". `done` runs in the thread.
  void Fold(std::string what, EditOf edit_of, Done done);

  // A trajectory_t; a rigid_transform_t of the frame of the poses in the map. They do not wait. Of
  // trajectories the newest is folded, every five seconds at most.
  void HandleTrajectory(absl::Span<const uint8_t> message);
  void HandlePlacement(absl::Span<const uint8_t> message);

  const WorkSteps& steps() { return mailbox_.steps(); }

  // Ends the thread, and what it does.
  void Stop();

 private:
  void Run(const std::stop_token& stop);
  absl::Status CheckSigner(absl::Span<const uint8_t> trajectory);
  void ReceiveTrajectory(absl::Span<const uint8_t> message);
  void FoldTrajectory();
  void ReceivePlacement(absl::Span<const uint8_t> message);
  void ForgetWhatIsOld();
  void FoldNow(const std::string& what, const EditOf& edit_of, const Done& done);
  absl::StatusOr<std::string> TryFold(const EditOf& edit_of);

  const std::shared_ptr<const KeyRing> keys_;
  const std::string signing_;  // what signatures of trajectories are of
  const std::string robot_;
  const MapOptions options_;
  const std::shared_ptr<TileMemory> memory_;
  const std::string folder_;  // of the map file
  const Utime forget_after_;
  NewestMap& newest_;
  MappingThread& mapping_;
  NoticeLog& notices_;
  Mailbox mailbox_;
  TrajectoryParts trajectory_parts_;
  absl::flat_hash_set<std::string> signatures_;  // of the parts that were taken
  std::optional<Trajectory> trajectory_;         // the newest, not folded yet
  Clock::time_point next_correction_;
  std::stop_token stop_;
  std::jthread folding_;
};

}  // namespace splinemap
