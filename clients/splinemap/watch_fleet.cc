#include "clients/splinemap/watch_fleet.h"

#include <algorithm>
#include <cstdio>
#include <nlohmann/json.hpp>
#include <string>
#include <thread>
#include <vector>

#include "clients/splinemap/commands.h"
#include "clients/splinemap/follow_fleet.h"
#include "clients/splinemap/layer_name.h"
#include "clients/splinemap/live_view.h"
#include "clients/splinemap/print.h"
#include "lib/base/clock.h"
#include "lib/base/status.h"

namespace splinemap {
namespace {

using std::chrono::milliseconds;

constexpr milliseconds kLineInterval(1000);
constexpr milliseconds kLookLineInterval(20);

// The copy at a moment.
struct FleetState {
  std::string map;
  std::vector<FollowedLayer> layers;
  std::vector<std::string> refused;
  int64_t bytes = 0;  // received
  std::string problem;

  size_t num_whole() const {
    return std::count_if(layers.begin(), layers.end(),
                         [](const FollowedLayer& layer) { return layer.matches_digest; });
  }
};

FleetState StateOf(const FollowedFleet& fleet) {
  const FleetReplica& replica = *fleet.replica;
  return {fleet.store->address().map, replica.FollowedLayers(), replica.Refused(),
          replica.BytesReceived(), fleet.Problem()};
}

nlohmann::json ToJson(const FleetState& state) {
  nlohmann::json layers = nlohmann::json::array();
  for (const FollowedLayer& layer : state.layers) {
    layers.push_back({{"name", layer.id.name},
                      {"origin", fmt::format("{:016x}", layer.id.origin)},
                      {"session_number", layer.session.number},
                      {"commits", layer.revision},
                      {"tiles", layer.tiles},
                      {"hash", fmt::format("{:016x}", layer.hash)},
                      {"is_whole", layer.matches_digest}});
  }
  return {{"map", state.map},
          {"layers", std::move(layers)},
          {"refused", state.refused},
          {"bytes_received", state.bytes},
          {"problem", state.problem}};
}

std::string LineOf(const FleetState& state) {
  size_t tiles = 0;
  for (const FollowedLayer& layer : state.layers) tiles += layer.tiles;
  std::string line = fmt::format("{}: {} layers, {} of them whole; {} tiles; {:.1f} MB received",
                                 state.map, state.layers.size(), state.num_whole(), tiles,
                                 static_cast<double>(state.bytes) / 1e6);
  if (!state.refused.empty()) line += fmt::format("; {} not followed", state.refused.size());
  if (!state.problem.empty()) line += "; " + state.problem;
  return line;
}

std::string TextOf(const FleetState& state) {
  std::string text = PlainText(LineOf(state)) + "\n\n";
  text += fmt::format("{:<37} {:>9} {:>9} {:>9}\n", "layer", "session", "tiles", "commit");
  // What does not fit the screen is in the line above, and in splinemap layers.
  constexpr size_t kMaxRows = 20;
  for (size_t k = 0; k < std::min(state.layers.size(), kMaxRows); ++k) {
    const FollowedLayer& layer = state.layers[k];
    text += fmt::format("{:<37} {:>9} {:>9} {:>9}  {}\n", NameOf(layer.id), layer.session.number,
                        layer.tiles, layer.revision, layer.matches_digest ? "whole" : "stale");
  }
  if (state.layers.size() > kMaxRows) {
    text += fmt::format("and {} more\n", state.layers.size() - kMaxRows);
  }
  for (size_t k = 0; k < std::min(state.refused.size(), kMaxRows); ++k) {
    text += fmt::format("not followed: {}\n", PlainText(state.refused[k]));
  }
  return text + "\n";
}

}  // namespace

absl::StatusOr<int> DrawFleet(const FleetAddress& address) {
  SPLINEMAP_ASSIGN_OR_RETURN(const FollowedFleet fleet, FollowFleet(address, {}));
  fmt::print("\x1b[2J");
  while (true) {
    fmt::print("{}", ScreenOf(TextOf(StateOf(fleet)), 1, *fleet.replica->View()));
    if (std::fflush(stdout) != 0) return kFailed;
    std::this_thread::sleep_for(kLineInterval);
  }
}

absl::StatusOr<int> PrintFleet(const FleetAddress& address, milliseconds patience, bool json,
                               bool once) {
  SPLINEMAP_ASSIGN_OR_RETURN(const FollowedFleet fleet, FollowFleet(address, {}));
  int64_t bytes = 0;
  auto next = Clock::now();
  for (auto since = Clock::now(); Clock::now() - since < patience;
       std::this_thread::sleep_for(kLookLineInterval)) {
    const FleetState state = StateOf(fleet);
    const bool gets_on = state.problem.empty() && fleet.replica->HasCompared();
    if (gets_on || state.bytes != bytes) since = Clock::now();
    bytes = state.bytes;
    if (!fleet.replica->HasCompared() || Clock::now() < next) continue;
    next = Clock::now() + kLineInterval;
    if (json) {
      PrintJson(ToJson(state), -1);
    } else {
      PrintLine(stdout, "{}", LineOf(state));
    }
    if (std::fflush(stdout) != 0) return kFailed;  // the reader is gone
    if (once) return kSuccess;
  }
  const std::string problem = fleet.Problem();
  return Unavailable("{}", problem.empty() ? "the fleet's servers send nothing" : problem);
}

}  // namespace splinemap
