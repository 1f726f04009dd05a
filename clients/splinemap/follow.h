#pragma once

#include <memory>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "clients/splinemap/bus_flags.h"
#include "splinemap/replica.h"

namespace CLI {
class App;
}

namespace splinemap {

// How long a follower may take to catch up, by default.
inline constexpr double kCatchUpTimeout_s = 10;

// Help for --robot of commands that follow layers.
inline constexpr const char* kLayersOfRobot =
    "Only the layers of this robot; * and ? are wildcards";

// Adds --robot, which may be repeated.
void AddRobotsFlag(CLI::App& command, std::vector<std::string>& names);

// Whether one of the layers is of a robot, or of one of a pattern.
bool HasLayerOf(const std::vector<FollowedLayer>& layers, const std::string& robot);

// Follows the daemons on a bus, whose channel_prefix replaces that of `options`, until their layers
// have caught up. Unavailable, with what is missing, after the timeout.
absl::StatusOr<std::unique_ptr<MapReplica>> FollowUntilCaughtUp(const BusFlags& bus,
                                                                FollowOptions options);

// Prints which layers are left out and why, on stderr. Returns the exit status of a command that
// else succeeded.
int ReportRefused(const std::vector<std::string>& refused);

}  // namespace splinemap
