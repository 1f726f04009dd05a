#pragma once

#include <compare>
#include <cstddef>
#include <cstdint>
#include <map>

#include "splinemap/fixed_pose2.h"
#include "splinemap/layer.h"

namespace splinemap {

// What people have decided about one layer, beside what its owner has measured. Everybody on a bus
// keeps the records of all layers, and passes them on.
struct LayerSettings {
  // Starts of a layer's owner come in generations of this many. A removal ends a generation, so
  // that an owner which was away and has been started since still belongs to what was removed.
  static constexpr uint64_t kSessionsPerGeneration = uint64_t{1} << 20;
  // Nobody who was away has missed more starts, or more settings: what is further ahead of all
  // that is known here is a mistake or a lie, which would use up the numbers for ever.
  static constexpr uint64_t kMaxSessionsAhead = uint64_t{1} << 30;
  static constexpr uint64_t kMaxSettingsAhead = uint64_t{1} << 32;

  bool muted = false;       // not in the sum
  bool low_weight = false;  // see SummedLayers
  FixedPose2 placement;     // map_T_layer: from the layer's frame to the map's
  // Of the above the last writer counts: the greatest (counter, writer).
  uint64_t counter = 0;
  uint64_t writer = 0;
  // The layer's sessions up to this session_number are gone for good, whatever other writers say.
  uint64_t removed_up_to = 0;

  auto operator<=>(const LayerSettings&) const = default;

  // Whether a file or a message may say so: placements and numbers within bounds, which leave room
  // to count on.
  bool IsValid() const;
  // Removes the layer for good: all sessions of the generation of `session`. A layer of that name
  // that comes later begins with the default settings.
  void Remove(const SessionId& session);
  bool IsRemoved(const SessionId& session) const { return session.number <= removed_up_to; }
  bool IsSummed() const { return !muted; }
};

// The record that results from two of one layer. Commutative, associative, idempotent.
LayerSettings Merge(const LayerSettings& a, const LayerSettings& b);

// The records of all layers that have one. Thread-compatible.
class SettingsTable {
 public:
  static constexpr size_t kMax = 1024;

  // The record without any setting where there is none.
  const LayerSettings& Of(const LayerId& id) const;
  const std::map<LayerId, LayerSettings>& records() const { return records_; }

  // Takes what another one knows. False where that is nothing new, or kMax is reached.
  bool Merge(const LayerId& id, const LayerSettings& setting);
  bool Merge(const SettingsTable& others);
  // As if the layer had never had one.
  void Erase(const LayerId& id);

  // The layer's record as `writer` may now change it and Merge() it: later than all that are known.
  LayerSettings Next(const LayerId& id, uint64_t writer) const;
  // The same, with the layer removed.
  LayerSettings Removal(const LayerId& id, const SessionId& session, uint64_t writer) const;

  // Of all records, the same in whatever order they came; 0 where there are none.
  uint64_t hash() const { return hash_; }

  // Counts on with every setting of a single writer.
  uint64_t greatest_counter() const;

  bool operator==(const SettingsTable& other) const { return records_ == other.records_; }

 private:
  std::map<LayerId, LayerSettings> records_;
  uint64_t hash_ = 0;  // sum of those of the records
};

}  // namespace splinemap
