#pragma once

#include <deque>

#include "absl/types/span.h"
#include "lib/mapping/beam_model.h"
#include "lib/mapping/scan_scratch.h"
#include "splinemap/layer.h"
#include "splinemap/scan.h"
#include "tests/bench/layers/scheme.h"

namespace splinemap {

// Robots with a layer each, by the defaults of the method but for the clamp in log-odds; knots 0.05
// m apart. Thread-compatible.
class Robots {
 public:
  Robots(size_t count, double clamp);

  void AddScan(size_t robot, absl::Span<const PlacedBeam> beams);

  // As read by the robot `first_own`.
  LayersOfRobots Layers(size_t first_own);

 private:
  ControlLimits limits_;
  BeamModel model_;
  ScanScratch scratch_;
  std::deque<Layer> layers_;
};

}  // namespace splinemap
