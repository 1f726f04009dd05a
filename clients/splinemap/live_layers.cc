#include "clients/splinemap/live_layers.h"

#include <chrono>
#include <map>
#include <utility>

#include "lcmtypes/splinemap/layer_status_t.hpp"
#include "lcmtypes/splinemap/layers_t.hpp"
#include "lib/base/clock.h"
#include "lib/base/status.h"
#include "lib/wire/decode.h"
#include "lib/wire/lcm_bus.h"

namespace splinemap {

void AddLiveFlags(CLI::App& command, LiveFlags& flags) {
  command.add_option("--lcm-url", flags.lcm_url, "LCM bus (default: LCM_DEFAULT_URL)")
      ->type_name("URL");
  command.add_option("--prefix", flags.channel_prefix, "channel_prefix of the daemons");
  command.add_option("--wait", flags.wait_s, "s to listen for daemons (default 1.5)")
      ->check(CLI::Range(0.1, 1e6));
}

absl::StatusOr<std::vector<layers_t>> ListenToLayers(const LiveFlags& flags) {
  SPLINEMAP_ASSIGN_OR_RETURN(const std::unique_ptr<LcmBus> bus, LcmBus::Open(flags.lcm_url));
  std::map<std::pair<std::string, int64_t>, layers_t> heard;
  bus->Subscribe(flags.channel_prefix + "_LAYERS",
                 [&](const std::string&, absl::Span<const uint8_t> message) {
                   auto layers = Decode<layers_t>(message);
                   if (layers.ok()) heard[{layers->name, layers->daemon_nonce}] = *layers;
                 });
  const auto end = Clock::now() + std::chrono::duration_cast<Clock::duration>(
                                      std::chrono::duration<double>(flags.wait_s));
  while (Clock::now() < end) bus->Handle(std::chrono::milliseconds(20));
  std::vector<layers_t> daemons;
  for (auto& [key, layers] : heard) daemons.push_back(std::move(layers));
  if (daemons.empty() && !bus->Problem().empty()) return Unavailable("{}", bus->Problem());
  if (daemons.empty()) {
    return NotFound(
        "no splinemapd was heard on {}_LAYERS in {} s; is one running, on this LCM bus, with this "
        "channel_prefix?",
        flags.channel_prefix, flags.wait_s);
  }
  return daemons;
}

}  // namespace splinemap
