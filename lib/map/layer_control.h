#pragma once

#include <array>
#include <compare>
#include <cstddef>
#include <cstdint>
#include <map>

#include "lib/map/layer.h"

namespace splinemap {

// Whole knots from a layer's frame to the map's: control point (i, j) of the layer is (i + shift.i,
// j + shift.j) of the map.
struct KnotShift {
  static constexpr int32_t kMax = 1 << 26;  // each way

  int32_t i = 0;
  int32_t j = 0;
  auto operator<=>(const KnotShift&) const = default;
};

// What people have decided about one layer, beside what its owner has measured. Everybody on a bus
// keeps the records of all layers, and passes them on.
struct LayerControl {
  // Starts of a layer's owner come in generations of this many. A removal ends a generation, so
  // that an owner which was away and has been started since still belongs to what was removed.
  static constexpr uint64_t kStartsPerGeneration = uint64_t{1} << 20;
  // Nobody who was away has missed more starts, or more decisions: what is further ahead of all
  // that is known here is a mistake or a lie, which would use up the numbers for ever.
  static constexpr uint64_t kMaxStartsAhead = uint64_t{1} << 30;
  static constexpr uint64_t kMaxDecisionsAhead = uint64_t{1} << 32;

  bool muted = false;   // not in the sum
  bool yields = false;  // see MergedTiles
  KnotShift shift;
  // A rigid transform after the shift: x_m, y_m, yaw_rad. This version passes it on, and leaves a
  // layer that has one out of the sum.
  std::array<double, 3> alignment{};
  // Of the above the last writer counts: the greatest (counter, writer).
  uint64_t counter = 0;
  uint64_t writer = 0;
  // The layer's lives up to this incarnation are gone for good, whatever other writers say.
  uint64_t removed_up_to = 0;

  auto operator<=>(const LayerControl&) const = default;

  // Whether a file or a message may say so: shifts and numbers within bounds that leave room to
  // count on.
  bool IsValid() const;
  bool IsRemoved(const LayerEpoch& epoch) const { return epoch.incarnation <= removed_up_to; }
  bool IsSummed() const { return !muted && alignment == std::array<double, 3>{}; }
};

// The record that results from two of one layer. Commutative, associative, idempotent.
LayerControl Merge(const LayerControl& a, const LayerControl& b);

// The records of all layers that have one. Thread-compatible.
class LayerControls {
 public:
  static constexpr size_t kMax = 1024;

  // The record without any decision where there is none.
  const LayerControl& Of(const LayerId& id) const;
  const std::map<LayerId, LayerControl>& records() const { return records_; }

  // Takes what another one knows. False where that is nothing new, or kMax is reached.
  bool Take(const LayerId& id, const LayerControl& control);
  bool Take(const LayerControls& others);
  // As if the layer had never had one.
  void Erase(const LayerId& id);

  // The layer's record as `writer` may now change it and Take() it: later than all that are known.
  LayerControl Next(const LayerId& id, uint64_t writer) const;
  // The same, with all of the generation of `incarnation` removed.
  LayerControl Removal(const LayerId& id, uint64_t incarnation, uint64_t writer) const;

  // Of all records, the same in whatever order they came; 0 where there are none.
  uint64_t hash() const { return hash_; }

  // Counts on with every decision of a single writer.
  uint64_t greatest_counter() const;

  bool operator==(const LayerControls& other) const { return records_ == other.records_; }

 private:
  std::map<LayerId, LayerControl> records_;
  uint64_t hash_ = 0;  // sum of those of the records
};

}  // namespace splinemap
