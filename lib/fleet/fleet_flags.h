#pragma once

#include <string>

#include "lib/fleet/fleet_address.h"

namespace CLI {
class App;
class Option;
}  // namespace CLI

namespace splinemap {

// Adds --fleet, which it returns, and with it --fleet-map and --credentials. Without --fleet
// `fleet` has no servers. Its program is that of the command.
CLI::Option* AddFleetFlags(CLI::App& command, FleetAddress& fleet);

// Whether a word of a command line is one of these flags, with a value or without.
bool IsFleetFlag(const std::string& word);

}  // namespace splinemap
