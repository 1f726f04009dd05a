#include "tests/bench/layers/robots.h"

#include <cmath>

#include "lib/config/config.h"

namespace splinemap {

Robots::Robots(size_t count, double clamp)
    : model_(BeamModelOptionsOf(config::Method()), kKnotInterval_m) {
  limits_.max = static_cast<ControlPoint>(std::lround(clamp * kUnitsPerLogOdds));
  limits_.min = static_cast<ControlPoint>(-limits_.max);
  for (size_t k = 0; k < count; ++k) layers_.emplace_back(LayerId{"robot", k}, SessionId{1, 1});
}

void Robots::AddScan(size_t robot, absl::Span<const PlacedBeam> beams) {
  model_.Accumulate(beams, scratch_);
  scratch_.CommitTo(layers_[robot], limits_);
}

LayersOfRobots Robots::Layers(size_t first_own) {
  LayersOfRobots layers{{}, first_own};
  for (Layer& layer : layers_) layers.tiles.push_back(layer.Snapshot().tiles);
  return layers;
}

}  // namespace splinemap
