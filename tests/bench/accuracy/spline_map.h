#pragma once

#include <memory>
#include <string>
#include <vector>

#include "lib/mapping/beam_model.h"
#include "splinemap/map_view.h"
#include "tests/bench/accuracy/tested_map.h"

namespace splinemap {

// A choice of defaults for the project's own map. A new one is one line in Variants().
struct Variant {
  std::string name;
  BeamModelOptions beams;
  ControlLimits limits;
  ControlLimits scan_limits;  // of what one scan changes in one control point
  bool no_return_is_free = false;
  bool compare_with_peers = false;  // in the table over drives at all resolutions, too
  bool in_paper_figures = false;

  // The log-odds that a beam ends at a point rather than passes it, where a surface of signed
  // distances has this value: it is 0 on the faces, and hits are likely from 3/4 knot before them
  // on. Both numbers were fitted to the held-out halves of Intel and Freiburg 079 alone.
  static double LogOddsOfHit(double surface) { return 2 * (surface + 6); }
  // In the values of its maps.
  double LevelOfFaces() const;
};

std::vector<Variant> Variants();

Method SplineMethod(const Variant& variant);

// The spline by the paper's update (36), each measurement by itself, in double.
Method PaperSplineMethod();

}  // namespace splinemap
