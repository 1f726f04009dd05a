#include "clients/splinemap/bus_flags.h"

#include <CLI/App.hpp>

#include "fmt/format.h"

namespace splinemap {

std::chrono::milliseconds BusFlags::Timeout() const {
  return std::chrono::ceil<std::chrono::milliseconds>(std::chrono::duration<double>(timeout_s));
}

absl::StatusOr<std::shared_ptr<const KeyRing>> BusFlags::Keys() const {
  if (keys.empty()) return nullptr;
  return KeyRing::Read(keys);
}

void RequireLive(CLI::Option* option, CLI::Option* live) {
  if (live != nullptr) option->needs(live)->group("With --live");
}

void AddLcmUrlFlag(CLI::App& command, std::string& lcm_url, CLI::Option* live) {
  RequireLive(command.add_option("--lcm-url", lcm_url, "LCM bus (default: LCM_DEFAULT_URL)")
                  ->type_name("URL"),
              live);
}

void AddBusFlags(CLI::App& command, BusFlags& flags, CLI::Option* live) {
  AddLcmUrlFlag(command, flags.lcm_url, live);
  RequireLive(command.add_option("--prefix", flags.channel_prefix, "channel_prefix of the daemons"),
              live);
  RequireLive(command
                  .add_option("--keys", flags.keys,
                              "Folder of splinemap keys: sign, and believe trusted keys alone")
                  ->type_name("FOLDER"),
              live);
}

CLI::Option* AddTimeoutFlag(CLI::App& command, BusFlags& flags, CLI::Option* live) {
  CLI::Option* const timeout =
      command
          .add_option("--timeout", flags.timeout_s,
                      fmt::format("s to wait for the daemons (default {:g})", flags.timeout_s))
          ->check(CLI::Range(0.01, 1e6));
  RequireLive(timeout, live);
  return timeout;
}

}  // namespace splinemap
