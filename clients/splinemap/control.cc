#include <cstdio>
#include <map>
#include <memory>
#include <string>
#include <vector>

#include "clients/client/map_client.h"
#include "clients/splinemap/commands.h"
#include "clients/splinemap/layer_name.h"
#include "clients/splinemap/live_layers.h"
#include "clients/splinemap/say.h"
#include "lib/base/status.h"

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
  uint64_t incarnation = 0;
};

// The layer, and a daemon that has it.
absl::StatusOr<Found> ListenForLayer(const ControlFlags& flags) {
  SPLINEMAP_ASSIGN_OR_RETURN(const std::vector<layers_t> daemons, ListenToLayers(flags.live));
  std::map<LayerId, Found> heard;
  for (const layers_t& daemon : daemons) {
    if (!flags.robot.empty() && daemon.name != flags.robot) continue;
    for (const layer_status_t& layer : daemon.layers) {
      const LayerId id{layer.name, static_cast<uint64_t>(layer.origin)};
      if (layer.state == "removed") continue;
      heard.try_emplace(id, daemon.name, id, static_cast<uint64_t>(layer.incarnation));
    }
  }
  std::vector<LayerId> ids;
  for (const auto& [id, found] : heard) ids.push_back(id);
  SPLINEMAP_ASSIGN_OR_RETURN(
      const LayerId id,
      FindLayer(ids, flags.layer, flags.robot.empty() ? "the bus" : "robot " + flags.robot));
  return heard.at(id);
}

absl::StatusOr<int> Decide(const std::string& command, const ControlFlags& flags) {
  absl::StatusOr<Found> layer = ListenForLayer(flags);
  // What daemons say may get lost.
  for (int n = 0; n < 3 && !layer.ok(); ++n) layer = ListenForLayer(flags);
  SPLINEMAP_RETURN_IF_ERROR(layer.status());
  ClientOptions options;
  options.channel_prefix = flags.live.channel_prefix;
  options.robot = layer->daemon;
  SPLINEMAP_ASSIGN_OR_RETURN(const auto client, MapClient::Connect(flags.live.lcm_url, options));
  LayerDecision decision{command, layer->id, layer->incarnation, {}};
  if (flags.shift.size() == 2) decision.shift = {flags.shift[0], flags.shift[1]};
  SPLINEMAP_RETURN_IF_ERROR(client->Decide(decision));
  Say(stderr, "{} has decided: {} {}; all others hear of it within a second or two", layer->daemon,
      command, NameOf(layer->id));
  return kSuccess;
}

constexpr const char* kControlExamples = R"(
Examples:
  splinemap control mute robot-3
  splinemap control shift robot-3 40 -2      40 knots along x and -2 along y, from its own frame
  splinemap control yield robot-3@5f20       others overrule it: its robot is gone
  splinemap control remove robot-3

Whatever daemon is asked: all daemons and clients on the bus follow, those that are away as soon as
they come back. LAYER is NAME, or NAME@ORIGIN where there are several. A removed layer is gone for
good, from the disk of its robot, too; unmute and insist take mute and yield back. splinemap layers
--live shows what is decided.)";

void AddDecision(CLI::App& control, const std::string& command, const std::string& what,
                 Command& chosen) {
  auto flags = std::make_shared<ControlFlags>();
  CLI::App* decision = control.add_subcommand(command, what);
  decision->add_option("LAYER", flags->layer, "NAME or NAME@ORIGIN")->required();
  if (command == "shift") {
    decision->add_option("KNOTS", flags->shift, "Whole knot intervals along x and y, each way")
        ->expected(2)
        ->required();
  }
  decision->add_option("--robot", flags->robot, "Daemon to ask (default: one that has the layer)")
      ->type_name("NAME");
  AddLiveFlags(*decision, flags->live);
  decision->callback(
      [command, flags, &chosen] { chosen = [=] { return Decide(command, *flags); }; });
}

}  // namespace

void AddControl(CLI::App& app, Command& chosen) {
  CLI::App* control =
      app.add_subcommand("control", "Mute, shift or remove a layer for all robots and clients");
  control->footer(kControlExamples);
  control->require_subcommand(1);
  AddDecision(*control, "mute", "Leave the layer out of the sum", chosen);
  AddDecision(*control, "unmute", "Take it in again", chosen);
  AddDecision(*control, "yield", "Let layers that do not yield overrule it", chosen);
  AddDecision(*control, "insist", "Let it count as much as others again", chosen);
  AddDecision(*control, "shift", "Move it by whole knots", chosen);
  AddDecision(*control, "remove", "Take it out for good", chosen);
}

}  // namespace splinemap
