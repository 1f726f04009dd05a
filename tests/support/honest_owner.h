#pragma once

#include <cstdint>
#include <optional>
#include <random>
#include <set>
#include <utility>
#include <vector>

#include "absl/types/span.h"
#include "lib/map/map.h"
#include "lib/replication/identity_watch.h"
#include "lib/replication/levels_publisher.h"

namespace splinemap {

// A robot that publishes a layer as the protocol says, whatever else is on the bus. Where another
// one claims its layer, or its layer is removed, it goes on as the protocol wants. Without clocks,
// threads or sockets of its own.
class HonestOwner {
 public:
  // The same `seed`, the same layer and the same changes.
  HonestOwner(const std::string& name, const MapOptions& options, uint64_t seed);

  // A commit that changes a tile.
  void Map(Clock::time_point now);

  // Any bytes from the bus.
  void Hear(absl::Span<const uint8_t> message, Clock::time_point now);
  // What it says now.
  std::vector<PublishedMessage> Speak(Clock::time_point now);

  // What it has mapped, in its present life.
  const LayerSnapshot& truth() const { return truth_; }
  LayerLife life() const { return {truth_.id, truth_.epoch, {}}; }
  // Whether it has ever mapped each of these tiles in the layer.
  bool HasMapped(const LayerId& id, const TileTree& tiles) const;

 private:
  void GoOnAs(const LayerId& id, const LayerEpoch& epoch);
  void Begin();
  void Remember();

  const MapOptions options_;
  std::mt19937_64 random_;
  Layer layer_;
  LayerSnapshot truth_;
  std::optional<LevelsPublisher> publisher_;
  IdentityWatch identity_;
  std::set<std::pair<LayerId, uint64_t>> mapped_;  // checksums of tiles
};

}  // namespace splinemap
