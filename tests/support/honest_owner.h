#pragma once

#include <cstdint>
#include <optional>
#include <random>
#include <set>
#include <utility>
#include <vector>

#include "absl/types/span.h"
#include "lib/replication/byte_budget.h"
#include "lib/replication/pyramid_publisher.h"
#include "lib/replication/replication_message.h"
#include "lib/replication/session_guard.h"
#include "splinemap/layer_set.h"
#include "tests/support/scan_mapper.h"

namespace splinemap {

// A robot that publishes a layer as the protocol says, whatever else is on the bus. Where another
// one claims its layer, or its layer is removed, it goes on as the protocol wants. Without clocks,
// threads or sockets of its own.
class HonestOwner {
 public:
  // The same `seed`, the same layer and the same changes. It maps scans, or tiles from elsewhere.
  HonestOwner(const std::string& name, const MapOptions& options, uint64_t seed,
              bool maps_scans = false);

  // A commit that changes a tile, or some.
  void Map(Clock::time_point now);

  // Any bytes from the bus.
  void Hear(absl::Span<const uint8_t> bytes, Clock::time_point now);
  // What it says now.
  std::vector<ReplicationMessage> Speak(Clock::time_point now);

  // What it has mapped, in its present session.
  const LayerSnapshot& truth() const { return truth_; }
  LayerRef ref() const { return {truth_.id, truth_.session, {}}; }
  // Whether it has ever mapped each of these tiles in the layer.
  bool HasMapped(const LayerId& id, const TileTree& tiles) const;

 private:
  void GoOnAs(const LayerId& id, const SessionId& session);
  void Begin();
  void Remember();

  const MapOptions options_;
  std::mt19937_64 random_;
  Layer layer_;
  std::optional<ScanMapper> mapper_;
  LayerSnapshot truth_;
  std::optional<PyramidPublisher> publisher_;
  std::optional<ByteBudget> budget_;  // of it
  SessionGuard guard_;
  std::set<std::pair<LayerId, uint64_t>> mapped_;  // checksums of tiles
};

}  // namespace splinemap
