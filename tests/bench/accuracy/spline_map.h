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

  // What is added to the surface for the log-odds of a hit: a surface that is 0 on faces says with
  // its sign on which side of a face a point is, and half of the hits lie before it.
  double LogOddsAtFace() const;
};

std::vector<Variant> Variants();

Method SplineMethod(const Variant& variant);

// The spline by the paper's update (36), each measurement by itself, in double.
Method PaperSplineMethod();

}  // namespace splinemap
