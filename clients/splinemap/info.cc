#include <CLI/App.hpp>
#include <cstdio>
#include <filesystem>
#include <memory>
#include <nlohmann/json.hpp>
#include <numbers>

#include "clients/splinemap/commands.h"
#include "clients/splinemap/files.h"
#include "clients/splinemap/print.h"
#include "lib/base/status.h"
#include "lib/map/placed_tile.h"
#include "lib/map/summed_layers.h"
#include "splinemap/file.h"
#include "splinemap/scan_archive.h"

namespace splinemap {
namespace {

int64_t TouchedControlPoints(const TileTree& tiles) {
  int64_t touched = 0;
  tiles.ForEach(
      [&](TileKey, const TileTree::Entry& entry) { touched += entry.tile->Touched().points; });
  return touched;
}

// The area that was seen; a touched control point stands for a square of the knot interval.
double Area(const MapOptions& options, const TileTree& tiles) {
  return static_cast<double>(TouchedControlPoints(tiles)) * options.knot_interval_m *
         options.knot_interval_m;
}

// Of its poses in the map, as --frame says it.
std::string FrameText(const LayerSnapshot& layer) {
  const Pose2 frame = layer.archive ? layer.archive->map_T_world.ToPose() : Pose2();
  return fmt::format("{:.6g},{:.6g},{:.6g}", frame.position_m.x(), frame.position_m.y(),
                     frame.yaw_rad * 180 / std::numbers::pi);
}

nlohmann::json ToJson(const LayerSet& map, const std::string& path) {
  const TileTree sum = ViewOf(map)->tiles;
  std::error_code ignored;
  nlohmann::json json = {
      {"file", path},
      {"file_bytes", std::filesystem::file_size(path, ignored)},
      {"knot_interval_m", map.options.knot_interval_m},
      {"clamp_min", map.options.limits.min / double{kUnitsPerLogOdds}},
      {"clamp_max", map.options.limits.max / double{kUnitsPerLogOdds}},
      {"tiles", sum.size()},
      {"area_m2", Area(map.options, sum)},
      {"layers", nlohmann::json::array()},
  };
  for (const LayerSnapshot& layer : map.layers) {
    json["layers"].push_back({{"name", layer.id.name},
                              {"origin", fmt::format("{:016x}", layer.id.origin)},
                              {"session_number", layer.session.number},
                              {"commits", layer.revision},
                              {"tiles", layer.tiles.size()},
                              {"area_m2", Area(map.options, layer.tiles)},
                              {"scans", layer.archive ? layer.archive->num_scans() : 0},
                              {"frame", FrameText(layer)},
                              {"is_approximate", IsApproximate(map.settings.Of(layer.id).placement,
                                                               map.options.knot_interval_m)}});
  }
  return json;
}

void PrintForPeople(const nlohmann::json& json) {
  const auto number = [](const nlohmann::json& value) { return value.get<double>(); };
  PrintLine(stdout, "{}: {:.0f} kB, {} tiles, {:.1f} m2 seen", json["file"].get<std::string>(),
            number(json["file_bytes"]) * 1e-3, json["tiles"].get<int64_t>(),
            number(json["area_m2"]));
  PrintLine(stdout, "knot interval {} m, control points {} .. {} log-odds",
            number(json["knot_interval_m"]), number(json["clamp_min"]), number(json["clamp_max"]));
  for (const nlohmann::json& layer : json["layers"]) {
    const auto frame = layer["frame"].get<std::string>();
    PrintLine(stdout,
              "layer {} ({}): session {}, {} commits, {} tiles, {:.1f} m2 seen{}, {} scans kept{}",
              layer["name"].get<std::string>(), layer["origin"].get<std::string>(),
              layer["session_number"].get<int64_t>(), layer["commits"].get<int64_t>(),
              layer["tiles"].get<int64_t>(), number(layer["area_m2"]),
              layer["is_approximate"].get<bool>() ? ", approximate" : "",
              layer["scans"].get<int64_t>(), frame == "0,0,0" ? "" : ", frame " + frame);
  }
}

absl::StatusOr<int> Info(const std::string& path, bool as_json) {
  SPLINEMAP_ASSIGN_OR_RETURN(const LoadedMap loaded, ReadMapFile(path));
  nlohmann::json json = ToJson(loaded.set, path);
  json["corruption"] = loaded.corruption;
  if (as_json) {
    PrintJson(json);
  } else {
    PrintForPeople(json);
  }
  return ReportCorruption(loaded);
}

}  // namespace

void AddInfo(CLI::App& app, Command& chosen) {
  struct InfoFlags {
    std::string map;
    bool json = false;
  };
  auto flags = std::make_shared<InfoFlags>();
  CLI::App* command = app.add_subcommand("info", "Describe a map file");
  command->footer(
      "\nExamples:\n  splinemap info lab.splinemap\n  splinemap info lab.splinemap --json");
  command->add_option("MAP", flags->map, "Map file")->required();
  AddJsonFlag(*command, flags->json);
  command->callback(
      [flags, &chosen] { chosen = [flags] { return Info(flags->map, flags->json); }; });
}

}  // namespace splinemap
