#include <cstdio>
#include <map>
#include <memory>
#include <string>
#include <vector>

#include "clients/splinemap/commands.h"
#include "clients/splinemap/layer_name.h"
#include "clients/splinemap/live_layers.h"
#include "clients/splinemap/say.h"
#include "lcmtypes/splinemap/layer_status_t.hpp"
#include "lcmtypes/splinemap/layers_t.hpp"
#include "lib/base/status.h"
#include "lib/client/map_client.h"

namespace splinemap {
namespace {

struct ControlFlags {
  LiveFlags live;
  std::string robot;
  std::string layer;
  std::vector<int32_t> shift;
};

struct Found {
  std::string daemon;
  LayerId id;
  uint64_t session_number = 0;
};

// The layer, and a daemon that has it.
absl::StatusOr<Found> ListenForLayer(const ControlFlags& flags) {
  SPLINEMAP_ASSIGN_OR_RETURN(const std::vector<layers_t> daemons, ListenToLayers(flags.live));
  std::map<LayerId, Found> heard;
  for (const layers_t& daemon : daemons) {
    if (!flags.robot.empty() && daemon.name != flags.robot) continue;
    for (const layer_status_t& layer : daemon.layers) {
      const LayerId id{layer.settings.name, static_cast<uint64_t>(layer.settings.origin)};
      if (layer.state == "removed") continue;
      heard.try_emplace(id, daemon.name, id, static_cast<uint64_t>(layer.session_number));
    }
  }
  std::vector<LayerId> ids;
  for (const auto& [id, found] : heard) ids.push_back(id);
  SPLINEMAP_ASSIGN_OR_RETURN(
      const LayerId id,
      FindLayer(ids, flags.layer, flags.robot.empty() ? "the bus" : "robot " + flags.robot));
  return heard.at(id);
}

absl::StatusOr<int> Set(LayerCommand command, const ControlFlags& flags) {
  absl::StatusOr<Found> layer = ListenForLayer(flags);
  // What daemons say may get lost.
  for (int n = 0; n < 3 && !layer.ok(); ++n) layer = ListenForLayer(flags);
  SPLINEMAP_RETURN_IF_ERROR(layer.status());
  ClientOptions options;
  options.channel_prefix = flags.live.channel_prefix;
  options.robot = layer->daemon;
  SPLINEMAP_ASSIGN_OR_RETURN(const auto client, MapClient::Connect(flags.live.lcm_url, options));
  LayerChange change{command, layer->id, layer->session_number, {}};
  if (flags.shift.size() == 2) change.shift = {flags.shift[0], flags.shift[1]};
  SPLINEMAP_RETURN_IF_ERROR(client->Set(change));
  Say(stderr, "{}: {} {}; all others follow within two seconds", layer->daemon, NameOf(command),
      NameOf(layer->id));
  return kSuccess;
}

constexpr const char* kControlExamples = R"(
Examples:
  splinemap control mute robot-3
  splinemap control shift robot-3 40 -2      40 knots along x and -2 along y, from its own frame
  splinemap control low-weight robot-3@5f20  it counts less than the others: its robot left
  splinemap control remove robot-3

Every daemon and client on the bus applies the setting, those that are offline now when they come
back. LAYER is NAME, or NAME@ORIGIN where there are several. A removed layer is gone for good, from
the disk of its robot, too. splinemap layers --live shows the settings.)";

void AddLayerCommand(CLI::App& parent, const LayerCommandText& text, Command& chosen) {
  auto flags = std::make_shared<ControlFlags>();
  CLI::App* setting = parent.add_subcommand(text.name, text.what);
  setting->add_option("LAYER", flags->layer, "NAME or NAME@ORIGIN")->required();
  if (text.command == LayerCommand::kShift) {
    setting->add_option("KNOTS", flags->shift, "Whole knot intervals along x and y, each way")
        ->expected(2)
        ->required();
  }
  setting->add_option("--robot", flags->robot, "Daemon to ask (default: one that has the layer)")
      ->type_name("NAME");
  AddLiveFlags(*setting, flags->live);
  setting->callback(
      [command = text.command, flags, &chosen] { chosen = [=] { return Set(command, *flags); }; });
}

}  // namespace

void AddControl(CLI::App& app, Command& chosen) {
  CLI::App* setting =
      app.add_subcommand("control", "Mute, shift or remove a layer for all robots and clients");
  setting->footer(kControlExamples);
  setting->require_subcommand(1);
  for (const LayerCommandText& text : kLayerCommands) AddLayerCommand(*setting, text, chosen);
}

}  // namespace splinemap
