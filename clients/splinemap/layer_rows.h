#pragma once

#include <cstddef>
#include <cstdint>
#include <nlohmann/json_fwd.hpp>
#include <optional>
#include <string>
#include <vector>

#include "splinemap/layer.h"
#include "splinemap/layer_settings.h"
#include "splinemap/map_view.h"
#include "splinemap/region.h"

namespace splinemap {

class layer_status_t;
struct LayerSet;

// A row of a table of layers.
struct LayerRow {
  struct Content {
    SessionId session;
    uint64_t revision = 0;
    size_t tiles = 0;
    double area_m2 = 0;         // known control points, each a square of the knot interval
    std::optional<Region> box;  // of these squares, in the map's frame; none where there are none
    uint64_t hash = 0;          // as in digests: the sum of the checksums of tiles
    // Share of its obstacles where the other layers saw free space (lib/map/contradictions.h).
    std::optional<double> contradicted;
  };
  LayerId id;
  std::optional<Content> content;  // none where only settings of the layer are there
  LayerSettings settings;
  FixedPose2 placement;  // from the frame of the robot's poses, where it is known, to the map's
  // In a daemon: "own", "live", "stale", "gone" or "removed", and the time since a message of the
  // owner, -1 before the first. In a fleet: "whole", "stale" or "removed".
  std::string state;
  double heard_s_ago = -1;
  bool is_approximate = false;  // resampled, since it is placed beside the knots of the map
  // In a fleet: since the copy of the robot's map file was made; none where there is no copy.
  std::optional<double> file_age_s{};
};

LayerRow RowOf(const LayerSnapshot& layer, const LayerSettings& settings, double knot_interval_m);

// As a daemon publishes it.
LayerRow RowOf(const layer_status_t& layer);

// Of the layers of a map, and then of those that only have settings.
std::vector<LayerRow> RowsOf(const LayerSet& map);

// Where the robot's poses lie in the map: as the settings say, beyond the frame of the layer.
FixedPose2 PlacementOf(const LayerSnapshot& layer, const LayerSettings& settings);

// "muted, placed at 2, -0.1 m, 30 deg", "removed"; empty for the default settings. `is_there`: the
// layer is in the map, not its settings alone.
std::string TextOf(const LayerSettings& settings, const FixedPose2& placement, bool is_there);

// A table with a header.
std::string TableOf(const std::vector<LayerRow>& rows);

nlohmann::json ToJson(const LayerRow& row);

}  // namespace splinemap
