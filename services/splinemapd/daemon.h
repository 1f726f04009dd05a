#pragma once

#include <atomic>
#include <chrono>
#include <cstdint>
#include <deque>
#include <future>
#include <map>
#include <memory>
#include <optional>
#include <set>
#include <string>
#include <thread>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "lcmtypes/splinemap/layers_t.hpp"
#include "lcmtypes/splinemap/status_t.hpp"
#include "lib/base/mutex.h"
#include "lib/config/config.h"
#include "lib/map/map.h"
#include "lib/pipeline/mapper.h"
#include "lib/replication/identity_watch.h"
#include "lib/replication/protocol.h"
#include "lib/store/map_file.h"
#include "lib/wire/lcm_bus.h"
#include "services/splinemapd/command_server.h"
#include "services/splinemapd/host_clock_watch.h"
#include "services/splinemapd/ingest_queue.h"
#include "services/splinemapd/layer_keeper.h"
#include "services/splinemapd/layer_roll.h"
#include "services/splinemapd/layer_server.h"
#include "services/splinemapd/notice_limiter.h"
#include "services/splinemapd/query_server.h"
#include "services/splinemapd/silence_watch.h"
#include "services/splinemapd/summed_map.h"

namespace splinemap {

// The mapping daemon: one thread receives, one maps, one saves, one serves followers, one follows
// others, one answers queries, one does what clients command. The caller's thread publishes status.
class Daemon {
 public:
  // Opens the map file and begins to map what comes on `bus`. The new incarnation of the layer is
  // on disk before anything is published. Errors say what stands in the way.
  static absl::StatusOr<std::unique_ptr<Daemon>> Start(const config::Config& config,
                                                       std::unique_ptr<LcmBus> bus);

  // As Stop(), with errors logged.
  ~Daemon();

  // Publishes a splinemap.status_t. Call it once a second.
  void PublishStatus();

  // Saves what is mapped by now; an error is logged.
  void SaveNow();

  // Stops receiving, maps what was received and can be placed, saves. The status of the save.
  absl::Status Stop();

 private:
  struct ScanTimes {
    int64_t scans = 0;
    std::chrono::nanoseconds total{0};
    std::chrono::nanoseconds longest{0};
  };

  // What the mapping thread shows to the others, between commits.
  struct State {
    std::shared_ptr<const MapSnapshot> map;  // of the daemon's own layer
    MapperCounts counts;
    size_t scans_queued = 0;
    Utime newest_scan_utime{0};
    Clock::time_point last_mapped;
    ScanTimes scan_times;  // since the last status
    std::optional<uint64_t> saved_revision;
    std::string last_problem;
    SymptomCounts symptoms{};  // beside those of the mapper
  };

  Daemon(const config::Config& config, std::unique_ptr<LcmBus> bus, MapFile file);
  // Return the layers of others that the file has, and what was decided about layers.
  absl::StatusOr<MapSnapshot> OpenMap();
  absl::StatusOr<MapSnapshot> LoadMap(const std::string& name);
  void Serve(const MapSnapshot& kept);
  void LookAtDigest(absl::Span<const uint8_t> message);
  // Of one name: each second one is told once.
  void FindNamesakes(const LayerId& first, const LayerId& second);
  void LookAtStandIn(absl::Span<const uint8_t> message);
  void LookAtPull(absl::Span<const uint8_t> message);
  LayerLife OwnLife();
  void LookAtIdentity();
  absl::Status BeginLife(const LayerLife& life, bool is_empty);
  absl::Status Do(const CommandServer::Request& request);
  absl::Status DecideAboutLayer(const layer_command_request_t& request);
  absl::Status ObeyRemoval();
  absl::Status CheckIncarnation(uint64_t incarnation);
  // Between two messages, in the mapping thread.
  absl::Status DoWhereMapped(std::function<absl::Status()> errand);
  void RunErrand();

  void Receive(const std::stop_token& stop);
  void MapMessages(const std::stop_token& stop);
  void MapOne(const IngestedMessage& message);
  void ShowState();
  void Report(const Notice& notice);
  void ReportDamages(const LoadedMap& loaded);
  // A symptom that the daemon sees beside the mapper.
  void Find(Symptom symptom, const std::string& subject, std::string text, int64_t times = 1);
  void LookAround();
  void LookForLosses();
  void LookAtQueries();
  void LookAtLayers();
  void SaveNowAndThen(const std::stop_token& stop);
  absl::Status Save();
  // What the file leaves out is reported. Where the file is not there any more, it is made anew, or
  // the map goes on in a rescue file.
  absl::Status SaveFile(const MapSnapshot& map) ABSL_EXCLUSIVE_LOCKS_REQUIRED(file_mutex_);
  absl::Status SaveElsewhere(const MapSnapshot& map, const absl::Status& why)
      ABSL_EXCLUSIVE_LOCKS_REQUIRED(file_mutex_);
  int64_t DroppedByOverload() const;
  status_t Status();
  layers_t Layers();

  config::Config config_;
  const Clock::time_point started_ = Clock::now();
  std::unique_ptr<LcmBus> bus_;
  IngestQueue ingest_;

  // Of the mapping thread alone, once it runs, but for mapper_->channels(), which do not change.
  std::unique_ptr<Map> map_;  // of the daemon's own layer
  Clock::time_point next_identity_look_;
  std::unique_ptr<Mapper> mapper_;
  ScanTimes scan_times_;  // since ShowState()
  Clock::time_point last_mapped_;

  Mutex file_mutex_ ABSL_ACQUIRED_BEFORE(mutex_);
  MapFile file_ ABSL_GUARDED_BY(file_mutex_);
  std::weak_ptr<const MapSnapshot> saved_ ABSL_GUARDED_BY(file_mutex_);

  // Of the caller's thread.
  HostClockWatch host_clock_;
  std::deque<SilenceWatch> silences_;  // as heard_
  std::set<std::string> extrinsics_channels_;
  int64_t lost_datagrams_ = 0;
  int64_t dropped_by_overload_ = 0;
  QueryServer::Counts noticed_queries_;
  std::set<std::string> noticed_refused_;
  std::map<LayerId, int64_t> noticed_disowned_;
  int64_t noticed_decisions_ = 0;
  int64_t noticed_ignored_ = 0;
  bool noticed_full_ = false;
  LayerRoll roll_;

  // By channel of the mapper: messages received. Written by the receiving thread.
  std::deque<std::atomic<int64_t>> heard_;

  Mutex mutex_;
  State state_ ABSL_GUARDED_BY(mutex_);
  NoticeLimiter limiter_ ABSL_GUARDED_BY(mutex_);
  IdentityWatch identity_ ABSL_GUARDED_BY(mutex_);
  std::set<LayerId> noticed_namesakes_ ABSL_GUARDED_BY(mutex_);
  LayerLife former_life_ ABSL_GUARDED_BY(mutex_);  // whose last messages are still under way
  std::unique_ptr<SummedMap> sum_;                 // of all layers
  uint64_t daemon_nonce_ = 0;                      // of this start, in replies and decisions

  std::packaged_task<absl::Status()> errand_ ABSL_GUARDED_BY(mutex_);

  std::unique_ptr<LayerServer> server_;
  std::unique_ptr<LayerKeeper> keeper_;
  std::unique_ptr<QueryServer> queries_;
  std::unique_ptr<CommandServer> commands_;
  std::jthread saving_;
  std::jthread mapping_;
  std::jthread receiving_;
};

}  // namespace splinemap
