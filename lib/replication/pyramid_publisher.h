#pragma once

#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <vector>

#include "lcmtypes/splinemap/layer_pull_t.hpp"
#include "lcmtypes/splinemap/scan_pull_t.hpp"
#include "lib/layers/layer_pyramid.h"
#include "lib/replication/byte_budget.h"
#include "lib/replication/layer_publisher.h"
#include "lib/replication/protocol.h"
#include "lib/replication/recent_scans.h"
#include "lib/replication/scan_publisher.h"

namespace splinemap {

// The owner's side of the protocol for one layer: pushes its scans, or its tiles as it was mapped,
// and makes and answers for those coarser levels that followers ask for. Without clocks, threads or
// sockets of its own. Thread-compatible.
class PyramidPublisher {
 public:
  // What `layer` has already counts as published: followers that lack it will pull it.
  PyramidPublisher(const LayerSnapshot& layer, const MapOptions& map_options,
                   const PublisherOptions& options)
      : PyramidPublisher(layer, map_options, options, nullptr) {}
  // A proxy's, which answers with those scans that its copy was made of.
  PyramidPublisher(const LayerSnapshot& layer, const MapOptions& map_options,
                   const PublisherOptions& options, RecentScans* scans);
  PyramidPublisher(const PyramidPublisher&) = delete;

  // A scan that the layer will have in a moment. What it has else is not sent as scans.
  void AddScan(SentScan scan, Clock::time_point now);
  // The layer's newest state, of the same session.
  void SetLayer(const LayerSnapshot& layer, Clock::time_point now);

  // Pulls of other layers and other sessions are ignored, and counted. One that asks for digests is
  // answered with the one of the layer as it was mapped.
  void HandlePull(const layer_pull_t& pull, Clock::time_point now);
  void HandleScanPull(const scan_pull_t& pull, Clock::time_point now);
  int64_t foreign_pulls() const { return foreign_pulls_; }

  // What is to be sent now. Call it a few times for each push_interval.
  std::vector<ReplicationMessage> Tick(Clock::time_point now, ByteBudget& budget);
  // See LayerPublisher.
  std::vector<ReplicationMessage> LastTick(Clock::time_point now, ByteBudget& budget);
  bool IsKnown(Clock::time_point now) const {
    return as_mapped_.IsKnown(now) && !scans_.HasChanges() && !scans_.HasPulls();
  }

  // What the budget is for.
  bool HasChanges() const { return as_mapped_.HasChanges() || scans_.HasChanges(); }
  bool HasPulls() const { return HasTilePulls() || scans_.HasPulls(); }
  // When Tick() will have something to do, if nothing comes before.
  Clock::time_point NextTick(Clock::time_point now) const;

 private:
  struct Asked {
    Clock::time_point last;
    std::unique_ptr<LayerPublisher> publisher;  // null until the level was made
  };

  bool HasTilePulls() const;
  void SendScans(Clock::time_point now, ByteBudget& budget,
                 std::vector<ReplicationMessage>& messages);
  void WorkOnLevels(Clock::time_point now);
  // Whether scans were sent that the layer does not have yet: it cannot be digested.
  bool IsBehind() const { return options_.sends_scans && scans_.revision() > layer_.revision; }

  const LayerRef ref_;  // at level 0
  const MapOptions map_options_;
  const PublisherOptions options_;
  LayerSnapshot layer_;
  RecentScans own_scans_;
  ScanPublisher scans_;
  LayerPublisher as_mapped_;
  LayerPyramid levels_{0};
  std::optional<Clock::time_point> behind_since_;         // of levels_
  std::map<LevelOfDetail, Asked, std::greater<>> asked_;  // the coarsest first
  int64_t foreign_pulls_ = 0;
};

}  // namespace splinemap
