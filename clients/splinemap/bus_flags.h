#pragma once

#include <chrono>
#include <memory>
#include <string>

#include "absl/status/statusor.h"
#include "splinemap/key_ring.h"

namespace CLI {
class App;
class Option;
}  // namespace CLI

namespace splinemap {

// Which daemons a command talks to, and how long it waits for them.
struct BusFlags {
  std::string lcm_url;  // empty: LCM's default
  std::string channel_prefix = "SPLINEMAP";
  std::string keys;  // folder; empty: none
  double timeout_s = 2;

  std::chrono::milliseconds Timeout() const;
  // Null where there are none.
  absl::StatusOr<std::shared_ptr<const KeyRing>> Keys() const;
};

// Makes the option require `live`, where that is not null, and groups it so in --help.
void RequireLive(CLI::Option* option, CLI::Option* live);

// Adds --lcm-url.
void AddLcmUrlFlag(CLI::App& command, std::string& lcm_url, CLI::Option* live = nullptr);
// Adds --lcm-url, --prefix and --keys.
void AddBusFlags(CLI::App& command, BusFlags& flags, CLI::Option* live = nullptr);
// Adds --timeout, with the default that `flags` has.
CLI::Option* AddTimeoutFlag(CLI::App& command, BusFlags& flags, CLI::Option* live = nullptr);

}  // namespace splinemap
