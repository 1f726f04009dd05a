#pragma once

#include <string>

#include "services/viewer/bus_watch.h"
#include "services/viewer/shown_map.h"
#include "splinemap/region.h"

namespace splinemap {

// The sections of a frame beside its tiles, in JSON. README.md has the fields.

struct MapFacts {
  bool is_file = false;
  std::string name;  // of the bus or the file
  bool allows_commands = false;
};

// The layer's key, in requests and answers.
std::string KeyOf(const LayerId& id);

std::string MapJson(const MapFacts& facts, const ShownMap& map, const MapView& view,
                    const TileBox& box);
// `bus` null: the layers of a file.
std::string LayersJson(const ShownMap& map, const BusState* bus);
std::string TimesJson(const MapTimes& times);
std::string DaemonsJson(const BusState& bus);
std::string PosesJson(const BusState& bus);
std::string ScansJson(const BusState& bus);
std::string PathsJson(const BusState& bus);

}  // namespace splinemap
