#include <cstdio>
#include <memory>
#include <nlohmann/json.hpp>

#include "clients/splinemap/commands.h"
#include "clients/splinemap/layer_lines.h"
#include "lib/base/status.h"

namespace splinemap {
namespace {

absl::StatusOr<int> Layers(const std::string& path, bool as_json) {
  SPLINEMAP_ASSIGN_OR_RETURN(const LoadedMap loaded, ReadMapFile(path));
  const std::vector<LayerLine> lines = LinesOf(*loaded.map);
  if (as_json) {
    nlohmann::json json = nlohmann::json::array();
    for (const LayerLine& line : lines) json.push_back(ToJson(line));
    // Names may be any bytes.
    fmt::print("{}\n", json.dump(2, ' ', false, nlohmann::json::error_handler_t::replace));
  } else {
    fmt::print("{}", TableOf(lines));
  }
  return ReportDamages(loaded);
}

constexpr const char* kExamples = R"(
Examples:
  splinemap layers fleet.splinemap
  splinemap layers fleet.splinemap --json | jq '.[] | select(.in_sum)'

A line for each layer, what one robot measured: its name and origin, how often its robot had started,
scans, tiles, the area that it knows and the box about it in the map's frame, as --region takes it,
and a hash: equal layers have equal hashes. Last comes what people have decided about it. Of layers
that were removed only that is left.)";

}  // namespace

void AddLayers(CLI::App& app, Command& chosen) {
  struct Flags {
    std::string map;
    bool json = false;
  };
  auto flags = std::make_shared<Flags>();
  CLI::App* command = app.add_subcommand("layers", "List the layers of a map");
  command->footer(kExamples);
  command->add_option("MAP", flags->map, "Map file")->required();
  command->add_flag("--json", flags->json, "Output for programs");
  command->callback(
      [flags, &chosen] { chosen = [flags] { return Layers(flags->map, flags->json); }; });
}

}  // namespace splinemap
