#pragma once

#include <cstdint>
#include <map>
#include <optional>
#include <string>

#include "absl/functional/function_ref.h"
#include "splinemap/layer_set.h"
#include "splinemap/map_view.h"

namespace splinemap {

// How far the obstacles of one layer contradict the other layers of a map. A layer whose frame is
// turned or displaced has most of its walls where the others saw free space.
struct Contradiction {
  // With fewer points nothing is said.
  static constexpr int64_t kMinCompared = 100;
  // Beyond that share the frames of layers are likely to differ: parts of one recorded drive have
  // up to 3 %, with 0.1 m between their frames 4 to 10 %, with 0.3 m 21 to 38 %, turned 30 to 69 %.
  static constexpr double kTooMuch = 0.2;

  int64_t compared = 0;      // control points: obstacles of the layer that the others know
  int64_t contradicted = 0;  // of these, with free space alone in the others within two knots

  // Nothing where too little was compared.
  std::optional<double> share() const;
  bool IsTooMuch() const { return share().value_or(0) > kTooMuch; }
};

// "43 % of 1,250 obstacles"; requires share().
std::string ObstaclesText(const Contradiction& contradiction);

// A control point of the map that was compared.
using ComparedPointVisitor =
    absl::FunctionRef<void(const LayerId&, int32_t i, int32_t j, bool is_contradicted)>;

// Compares each layer that is in the sum with the sum of all others. `sum` is that of `set`. Where
// it is clamped, or of layers of low weight, the others seem to say less than they do. Costs the
// obstacles of all layers, and all of those that are placed.
void VisitComparedPoints(const LayerSet& set, const MapView& sum, ComparedPointVisitor visit);
std::map<LayerId, Contradiction> ContradictionsOf(const LayerSet& set, const MapView& sum);

}  // namespace splinemap
