#include <cstdio>
#include <memory>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "clients/splinemap/commands.h"
#include "clients/splinemap/layer_rows.h"
#include "clients/splinemap/live_layers.h"
#include "clients/splinemap/say.h"
#include "lcmtypes/splinemap/layer_status_t.hpp"
#include "lcmtypes/splinemap/layers_t.hpp"
#include "lib/base/status.h"

namespace splinemap {
namespace {

struct LayersFlags {
  std::string map;
  bool live = false;
  bool json = false;
  LiveFlags bus;
};

nlohmann::json ToJson(const std::vector<LayerRow>& rows) {
  nlohmann::json json = nlohmann::json::array();
  for (const LayerRow& row : rows) json.push_back(splinemap::ToJson(row));
  return json;
}

absl::StatusOr<int> LayersOfDaemons(const LayersFlags& flags) {
  SPLINEMAP_ASSIGN_OR_RETURN(const std::vector<layers_t> daemons, ListenToLayers(flags.bus));
  nlohmann::json json = nlohmann::json::array();
  for (const layers_t& daemon : daemons) {
    std::vector<LayerRow> rows;
    for (const layer_status_t& layer : daemon.layers) rows.push_back(RowOf(layer));
    if (flags.json) {
      json.push_back({{"daemon", daemon.name},
                      {"daemon_nonce", fmt::format("{:016x}", daemon.daemon_nonce)},
                      {"layers", ToJson(rows)},
                      {"refused", daemon.refused}});
      continue;
    }
    Say(stdout, "{}:", daemon.name);
    fmt::print("{}", TableOf(rows));
    for (const std::string& refused : daemon.refused) {
      Say(stdout, "refused {}", refused);
    }
    if (&daemon != &daemons.back()) fmt::print("\n");
  }
  if (flags.json) PrintJson(json);
  return kSuccess;
}

absl::StatusOr<int> Layers(const LayersFlags& flags) {
  if (flags.live == !flags.map.empty()) {
    return InvalidArgument("name a map file, or ask the daemons on a bus with --live");
  }
  if (flags.live) return LayersOfDaemons(flags);
  SPLINEMAP_ASSIGN_OR_RETURN(const LoadedMap loaded, ReadMapFile(flags.map));
  const std::vector<LayerRow> rows = RowsOf(loaded.set);
  if (flags.json) {
    PrintJson(ToJson(rows));
  } else {
    fmt::print("{}", TableOf(rows));
  }
  return ReportCorruption(loaded);
}

constexpr const char* kLayersExamples = R"(
Examples:
  splinemap layers fleet.splinemap
  splinemap layers fleet.splinemap --json | jq '.[] | select(.in_sum)'
  splinemap layers --live                          what each daemon on the bus has

A row for each layer, what one robot measured: its name and origin, how often its robot had started,
scans, tiles, the area that it knows and the box about it in the map's frame, as --region takes it,
and a hash: equal layers have equal hashes. Last come the settings of people. Of layers
that were removed only that is left.

Of a daemon's layers it says, too, whether each is its own, live, stale (something is missing) or gone
(its robot is silent, and all is kept), and how many seconds ago its robot was heard; areas and boxes
are those of tiles then.)";

}  // namespace

void AddLayers(CLI::App& app, Command& chosen) {
  auto flags = std::make_shared<LayersFlags>();
  CLI::App* command =
      app.add_subcommand("layers", "List the layers of a map, or those of the daemons on a bus");
  command->footer(kLayersExamples);
  command->add_option("MAP", flags->map, "Map file");
  command->add_flag("--live", flags->live, "Listen to daemons instead of reading a file");
  AddLiveFlags(*command, flags->bus);
  command->add_flag("--json", flags->json, "Output for programs");
  command->callback([flags, &chosen] { chosen = [flags] { return Layers(*flags); }; });
}

}  // namespace splinemap
