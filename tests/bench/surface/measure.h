#pragma once

#include <optional>
#include <vector>

#include "tests/bench/accuracy/tested_map.h"
#include "tests/bench/surface/scene.h"

namespace splinemap {

// What a map says of a scene. Errors in metres; negative is in front of the face.
struct Findings {
  std::vector<double> ray_errors_m;  // along the normal of the face; of rays that met something
  int rays = 0;
  int rays_missed = 0;  // met nothing up to 0.15 m behind the face, or something 0.3 m before it
  std::vector<double> distance_errors_m;  // found minus true
  std::optional<double> gap_m;            // the widest disc that passes; of scenes with a gap
};

// Obstacles are where the map's log-odds are above `level`.
Findings Measure(TestedMap& map, double level, const Scene& scene, const Pose2& world_T_scene);

}  // namespace splinemap
