#pragma once

#include <string>

#include "services/viewer/bus_watch.h"
#include "services/viewer/shown_map.h"
#include "splinemap/layer_settings.h"
#include "splinemap/pose2.h"
#include "splinemap/region.h"

namespace splinemap {

// The sections of a frame beside its tiles, in JSON. README.md has the fields.

struct MapFacts {
  std::string source = "bus";  // or "fleet" or "file"
  std::string name;            // of it
  bool allows_commands = false;
};

// The layer's key, in requests and answers.
std::string KeyOf(const LayerId& id);

std::string MapJson(const MapFacts& facts, const ShownMap& map, const MapView& view,
                    const TileBox& box);
// `bus` null: the layers of a file or a fleet.
std::string LayersJson(const ShownMap& map, const BusState* bus);
std::string TimesJson(const MapTimes& times);
// None is silent that had no time to answer: daemons are asked from `asked_since` on, and say
// little where nobody asks.
std::string DaemonsJson(const BusState& bus, Clock::time_point asked_since);
// From the frame of the poses on the bus to that of the map. Known where the daemons that hear
// poses are of one robot; with several nobody says whose a channel is, and it is none.
Pose2 MapFromPoses(const BusState& bus, const SettingsTable& settings);
std::string PosesJson(const BusState& bus, const Pose2& map_T_poses);
std::string ScansJson(const BusState& bus, const Pose2& map_T_poses);
std::string PathsJson(const BusState& bus);

}  // namespace splinemap
