#pragma once

#include <cstddef>
#include <cstdint>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <vector>

#include "lcmtypes/splinemap/layer_status_t.hpp"
#include "lib/layers/layer.h"
#include "lib/layers/layer_settings.h"
#include "lib/map/map_view.h"
#include "lib/tiles/region.h"

namespace splinemap {

// What people are shown of a layer.
struct LayerRow {
  struct Content {
    SessionId session;
    uint64_t revision = 0;
    size_t tiles = 0;
    double area_m2 = 0;         // known control points, each a square of the knot interval
    std::optional<Region> box;  // of these squares, in the map's frame; none where there are none
    uint64_t hash = 0;          // as in digests: the sum of the checksums of tiles
  };
  LayerId id;
  std::optional<Content> content;  // none where only a record about the layer is there
  LayerSettings setting;
  // Of a daemon's: "own", "live", "stale", "gone"; since its owner was heard, -1 if not yet.
  std::string state;
  double heard_s_ago = -1;
};

LayerRow RowOf(const LayerSnapshot& layer, const LayerSettings& setting, double knot_interval_m);

// As a daemon says it. Its areas and boxes are of tiles.
LayerRow RowOf(const layer_status_t& layer);

// Of the layers of a map, and then of those that only have a record.
std::vector<LayerRow> RowsOf(const LayerSet& map);

// "muted, shifted by 3, -2 knots"; empty where nothing was set.
std::string TextOf(const LayerSettings& setting, const std::optional<SessionId>& session);

// A table with a header.
std::string TableOf(const std::vector<LayerRow>& rows);

nlohmann::json ToJson(const LayerRow& row);

}  // namespace splinemap
