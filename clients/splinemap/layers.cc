#include <CLI/App.hpp>
#include <cstdio>
#include <memory>
#include <nlohmann/json.hpp>
#include <set>
#include <string>
#include <vector>

#include "clients/splinemap/commands.h"
#include "clients/splinemap/files.h"
#include "clients/splinemap/fleet_scans.h"
#include "clients/splinemap/follow.h"
#include "clients/splinemap/follow_fleet.h"
#include "clients/splinemap/layer_rows.h"
#include "clients/splinemap/live_layers.h"
#include "clients/splinemap/map_source.h"
#include "clients/splinemap/print.h"
#include "lcmtypes/splinemap/layer_status_t.hpp"
#include "lib/base/status.h"
#include "splinemap/file.h"

namespace splinemap {
namespace {

struct LayersFlags {
  MapSourceFlags source;
  bool json = false;
};

nlohmann::json RowsToJson(const std::vector<LayerRow>& rows) {
  nlohmann::json json = nlohmann::json::array();
  for (const LayerRow& row : rows) json.push_back(ToJson(row));
  return json;
}

absl::StatusOr<int> PrintLiveLayers(const LayersFlags& flags) {
  SPLINEMAP_ASSIGN_OR_RETURN(const std::vector<layers_t> daemons,
                             ReceiveLayers(flags.source.bus, flags.source.robot));
  nlohmann::json json = nlohmann::json::array();
  for (const layers_t& daemon : daemons) {
    std::vector<LayerRow> rows;
    for (const layer_status_t& layer : daemon.layers) rows.push_back(RowOf(layer));
    if (flags.json) {
      json.push_back({{"daemon", daemon.name},
                      {"daemon_nonce", fmt::format("{:016x}", daemon.daemon_nonce)},
                      {"layers", RowsToJson(rows)},
                      {"refused", daemon.refused}});
      continue;
    }
    PrintLine(stdout, "{}:", daemon.name);
    fmt::print("{}", TableOf(rows));
    for (const std::string& refused : daemon.refused) {
      PrintLine(stdout, "refused {}", refused);
    }
    if (&daemon != &daemons.back()) fmt::print("\n");
  }
  if (flags.json) PrintJson(json);
  return kSuccess;
}

void PrintRows(const std::vector<LayerRow>& rows, bool json) {
  if (json) {
    PrintJson(RowsToJson(rows));
  } else {
    fmt::print("{}", TableOf(rows));
  }
}

absl::Status AddFileAges(const FleetAddress& fleet, std::vector<LayerRow>& rows) {
  SPLINEMAP_ASSIGN_OR_RETURN(const auto files, NatsFleetStore::Connect(FilesOf(fleet)));
  for (LayerRow& row : rows) {
    const absl::StatusOr<FleetFile> file = FindFleetFile(*files, row.id);
    if (file.ok()) {
      row.file_age_s = AgeOf(*file).count();
    } else if (absl::IsNotFound(file.status())) {
      return absl::OkStatus();  // a map that has no files
    } else if (!absl::IsOutOfRange(file.status())) {
      return file.status();
    }
  }
  return absl::OkStatus();
}

// Also those that are not whole yet, as far as they are here.
absl::StatusOr<int> PrintFleetLayers(const LayersFlags& flags) {
  SPLINEMAP_ASSIGN_OR_RETURN(const FollowedFleet fleet, FollowFleet(flags.source.fleet, {}));
  const absl::Status whole = AwaitWhole(fleet, {}, flags.source.bus.Timeout());
  if (!whole.ok() && !fleet.replica->map_options()) return whole;
  std::vector<LayerRow> rows = RowsOf(fleet.replica->Layers());
  std::set<LayerId> matching;
  for (const FollowedLayer& layer : fleet.replica->FollowedLayers()) {
    if (layer.matches_digest) matching.insert(layer.id);
  }
  for (LayerRow& row : rows) {
    row.state = !row.content ? "removed" : matching.contains(row.id) ? "whole" : "stale";
  }
  const absl::Status files = AddFileAges(flags.source.fleet, rows);
  PrintRows(rows, flags.json);
  const int exit_status = ReportRefused(fleet.replica->Refused());
  if (!whole.ok()) return whole;
  SPLINEMAP_RETURN_IF_ERROR(files);
  return exit_status;
}

absl::StatusOr<int> PrintLayers(const LayersFlags& flags) {
  SPLINEMAP_ASSIGN_OR_RETURN(const auto arguments, ArgumentsAfterMap(flags.source));
  if (!arguments.empty()) {
    return InvalidArgument("{} is one argument too many; give a map file, --live or --fleet",
                           arguments.front());
  }
  if (flags.source.live) return PrintLiveLayers(flags);
  if (flags.source.IsFleet()) return PrintFleetLayers(flags);
  SPLINEMAP_ASSIGN_OR_RETURN(const LoadedMap loaded, ReadMapFile(flags.source.arguments.front()));
  PrintRows(RowsOf(loaded.set), flags.json);
  return ReportCorruption(loaded);
}

constexpr const char* kLayersExamples = R"(
Examples:
  splinemap layers fleet.splinemap
  splinemap layers fleet.splinemap --json | jq '.[] | select(.in_sum)'
  splinemap layers --live                          the layers of each daemon on the bus
  splinemap layers --fleet nats://hub

Prints a row for each layer: name@origin, session, commits, tiles, known area, the share of its
obstacles where the other layers saw free space (- where less than 100 can be compared), the box
around the known area in the map frame as --region takes it, and a hash, equal for equal layers. The
last column has the settings. Beyond 20 % the frame of a layer may be another; splinemap render
--contradictions shows where.

With --live it prints a table for each daemon. "state" is own, live, stale (something is missing),
gone (its robot is silent; the layer is kept) or removed; "heard_s" is the time since the last
message of its robot. With --fleet "state" is whole, stale (some tiles are missing) or removed, and "file_s" the
age of the copy of the robot's map file, where there is one (splinemap snapshot --scans).)";

}  // namespace

void AddLayers(CLI::App& app, Command& chosen) {
  auto flags = std::make_shared<LayersFlags>();
  CLI::App* command = app.add_subcommand("layers", "List the layers of a map");
  command->footer(kLayersExamples);
  AddMapSource(*command, "MAP", "", flags->source);
  AddJsonFlag(*command, flags->json);
  command->callback([flags, &chosen] { chosen = [flags] { return PrintLayers(*flags); }; });
}

}  // namespace splinemap
