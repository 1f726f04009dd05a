#pragma once

#include <chrono>
#include <string>

namespace CLI {
class App;
class Option;
}  // namespace CLI

namespace splinemap {

// Which daemons a command talks to, and how long it waits for them.
struct BusFlags {
  std::string lcm_url;  // empty: LCM's default
  std::string channel_prefix = "SPLINEMAP";
  double timeout_s = 2;

  std::chrono::milliseconds Timeout() const;
};

// Makes the option require `live`, where that is not null, and groups it so in --help.
void RequireLive(CLI::Option* option, CLI::Option* live);

// Adds --lcm-url.
void AddLcmUrlFlag(CLI::App& command, std::string& lcm_url, CLI::Option* live = nullptr);
// Adds --lcm-url and --prefix.
void AddBusFlags(CLI::App& command, BusFlags& flags, CLI::Option* live = nullptr);
// Adds --timeout, with the default that `flags` has.
void AddTimeoutFlag(CLI::App& command, BusFlags& flags, CLI::Option* live = nullptr);

}  // namespace splinemap
