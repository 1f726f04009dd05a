#pragma once

#include "lib/simulation/simulation.h"
#include "splinemap/map_view.h"

namespace splinemap::doctor_law {

// How a map shows a world.
struct Quality {
  double off = 0;    // share of occupied cells of 5 cm that lie farther than 15 cm from every wall
  double found = 0;  // share of the walls with an occupied cell within 10 cm

  // One number, the harmonic mean of what is right of the map and what is found of the walls.
  double score() const {
    const double right = 1 - off;
    return right + found > 0 ? 2 * right * found / (right + found) : 0;
  }
};

Quality Compare(const MapView& map, const simulation::World& world);

}  // namespace splinemap::doctor_law
