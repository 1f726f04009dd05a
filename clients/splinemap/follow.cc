#include "clients/splinemap/follow.h"

#include <CLI/App.hpp>
#include <algorithm>
#include <chrono>
#include <thread>
#include <utility>

#include "clients/splinemap/commands.h"
#include "clients/splinemap/print.h"
#include "fmt/ranges.h"
#include "lib/base/clock.h"
#include "lib/base/status.h"
#include "lib/replication/map_follower.h"

namespace splinemap {
namespace {

bool HasCaughtUp(const MapReplica& replica, const std::vector<std::string>& robots) {
  const std::vector<FollowedLayer> layers = replica.FollowedLayers();
  return replica.IsCaughtUp() &&
         std::all_of(robots.begin(), robots.end(),
                     [&](const std::string& robot) { return HasLayerOf(layers, robot); });
}

std::string WhatIsMissing(const MapReplica& replica, const std::vector<std::string>& robots) {
  std::string missing;
  for (const std::string& refused : replica.Refused()) {
    missing += fmt::format("; not followed: {}", PlainText(refused));
  }
  const std::vector<FollowedLayer> layers = replica.FollowedLayers();
  for (const FollowedLayer& layer : layers) {
    if (layer.caught_up && layer.matches_digest) continue;
    missing += fmt::format("; {} has {} tiles so far", PlainText(layer.id.name), layer.tiles);
  }
  for (const std::string& robot : robots) {
    if (layers.empty() || HasLayerOf(layers, robot)) continue;
    missing += fmt::format("; no layer of {} was received", PlainText(robot));
  }
  return missing;
}

}  // namespace

bool HasLayerOf(const std::vector<FollowedLayer>& layers, const std::string& robot) {
  return std::any_of(layers.begin(), layers.end(),
                     [&](const FollowedLayer& layer) { return MatchesName(robot, layer.id.name); });
}

void AddRobotsFlag(CLI::App& command, std::vector<std::string>& names) {
  command.add_option("--robot", names, std::string(kLayersOfRobot) + "; may be repeated")
      ->type_name("NAME")
      ->allow_extra_args(false);  // the next argument may be a file
}

absl::StatusOr<std::unique_ptr<MapReplica>> FollowUntilCaughtUp(const BusFlags& bus,
                                                                FollowOptions options) {
  options.channel_prefix = bus.channel_prefix;
  SPLINEMAP_ASSIGN_OR_RETURN(options.keys, bus.Keys());
  SPLINEMAP_ASSIGN_OR_RETURN(auto replica, MapReplica::Follow(bus.lcm_url, options));
  const auto begin = Clock::now();
  const std::chrono::duration<double> timeout = bus.Timeout();
  while (Clock::now() - begin < timeout) {
    std::this_thread::sleep_for(std::chrono::milliseconds(20));
    if (HasCaughtUp(*replica, options.names)) return replica;
  }
  if (const std::string problem = replica->BusProblem(); !problem.empty()) {
    return Unavailable("{}", problem);
  }
  std::string missing = WhatIsMissing(*replica, options.names);
  for (const std::string& why : replica->Disbelieved()) missing += "; not believed: " + why;
  if (missing.empty() && replica->FollowedLayers().empty()) {
    const std::string of_robots =
        options.names.empty() ? ""
                              : PlainText(fmt::format(" of {}", fmt::join(options.names, ", ")));
    return Unavailable(
        "no map{} was received on {}_DIGESTS in {:g} s; is splinemapd on this bus?{}", of_robots,
        bus.channel_prefix, bus.timeout_s,
        of_robots.empty() ? "" : " splinemap watch shows who is there");
  }
  return Unavailable("the map has not caught up after {:g} s{}; --timeout gives it more time",
                     bus.timeout_s, missing);
}

int ReportRefused(const std::vector<std::string>& refused) {
  for (const std::string& name_and_why : refused) PrintLine(stderr, "left out: {}", name_and_why);
  return refused.empty() ? kSuccess : kFailed;
}

}  // namespace splinemap
