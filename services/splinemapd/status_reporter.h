#pragma once

#include <chrono>
#include <deque>
#include <map>
#include <optional>
#include <set>
#include <string>
#include <vector>

#include "lcmtypes/splinemap/layers_t.hpp"
#include "lcmtypes/splinemap/status_t.hpp"
#include "lib/config/config.h"
#include "services/splinemapd/announcement.h"
#include "services/splinemapd/contradiction_watch.h"
#include "services/splinemapd/host_clock_watch.h"
#include "services/splinemapd/layer_report.h"
#include "services/splinemapd/map_saver.h"
#include "services/splinemapd/mapping_thread.h"
#include "services/splinemapd/newest_map.h"
#include "services/splinemapd/notice_log.h"
#include "services/splinemapd/receiving_thread.h"
#include "services/splinemapd/replication_thread.h"
#include "services/splinemapd/request_server.h"
#include "services/splinemapd/silence_watch.h"
#include "services/splinemapd/tile_budget.h"

namespace splinemap {

// Makes the status messages of a daemon, and reports what is wrong with it.
// Thread-compatible.
class StatusReporter {
 public:
  // The parts of the daemon that it reports on; all outlive it.
  struct Parts {
    NewestMap& newest;
    NoticeLog& notices;
    ReceivingThread& receiving;
    MappingThread& mapping;
    ReplicationThread& replication;
    RequestServer& requests;
    MapSaver& saver;
  };
  StatusReporter(const config::Config& config, const Parts& parts, TileBudget budget);

  // Checks the daemon and its surroundings, and reports what changed since the last time.
  void CheckHealth();

  status_t MakeStatus();
  // What is to be published now, nothing where nobody would learn anything from it. Both go where
  // somebody asks who is there; else status_t where anything but its clocks has changed, or after
  // 5 s, so that a daemon that ended is missed; layers_t where others are there or in another
  // state, since it lists all that every daemon has.
  std::optional<status_t> StatusToPublish(Clock::time_point now);
  std::optional<layers_t> LayersToPublish(Clock::time_point now);

 private:
  layers_t MakeLayers(const LayerSet& set, std::vector<layer_status_t> statuses) const;
  void CheckClock();
  void CheckMemory();
  void CheckDisk();
  void CheckSilence();
  void CheckLosses();
  void CheckRequests();
  void CheckReplication(const ReplicationThread::Report& report);
  void CheckLayers(const ReplicationThread::Report& report);
  void CheckDuplicateNames();
  void CheckContradictions();
  void CheckForRobots(const ReplicationThread::Report& report);
  void ReportDuplicateName(const LayerId& first, const LayerId& second);
  int64_t DroppedByOverload() const;
  // The growth of a count since the last call.
  int64_t Growth(const std::string& count, int64_t value);

  const config::Config config_;
  const Parts parts_;
  TileBudget budget_;
  bool was_short_ = false;
  std::string why_refused_;
  std::optional<uint64_t> limited_at_;
  const Clock::time_point started_ = Clock::now();
  HostClockWatch host_clock_;
  std::map<std::string, SilenceWatch> silences_;  // by channel
  std::set<std::string> extrinsics_channels_;
  std::map<std::string, int64_t> counts_;
  std::set<std::string> reported_refused_;
  std::set<LayerId> reported_names_;
  std::map<LayerId, int64_t> disowned_;
  ContradictionWatch contradictions_{started_};
  std::set<LayerId> contradicting_;
  bool was_full_ = false;
  bool said_alone_ = false;
  ReplicationThread::Report replication_;  // of the last CheckHealth()
  Announcement status_announcement_{std::chrono::seconds(5)};
  Announcement layers_announcement_{Clock::duration::max()};
  LayerReport layer_report_;
};

}  // namespace splinemap
