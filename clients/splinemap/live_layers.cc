#include "clients/splinemap/live_layers.h"

#include <map>
#include <memory>
#include <utility>

#include "lib/base/clock.h"
#include "lib/base/random.h"
#include "lib/base/status.h"
#include "lib/replica/caller.h"
#include "lib/replication/admission.h"
#include "lib/wire/lcm_bus.h"

namespace splinemap {

absl::StatusOr<std::vector<layers_t>> ReceiveLayers(const BusFlags& bus, const std::string& robot) {
  SPLINEMAP_ASSIGN_OR_RETURN(const std::unique_ptr<LcmBus> lcm, LcmBus::Open(bus.lcm_url));
  SPLINEMAP_ASSIGN_OR_RETURN(const auto keys, bus.Keys());
  Admission admission(bus.channel_prefix, keys, RandomId());
  std::map<std::pair<std::string, int64_t>, layers_t> received;
  lcm->Subscribe(
      bus.channel_prefix + "_LAYERS", [&](const std::string&, absl::Span<const uint8_t> message) {
        const auto admitted = admission.Admit(message);
        const auto* layers = admitted ? std::get_if<layers_t>(&admitted->content) : nullptr;
        if (layers == nullptr || (!robot.empty() && layers->name != robot)) return;
        received[{layers->name, layers->daemon_nonce}] = *layers;
      });
  Caller caller(*lcm, bus.channel_prefix, keys);
  const auto end = Clock::now() + bus.Timeout();
  while (Clock::now() < end) {
    caller.Tick(Clock::now());
    lcm->Handle(std::chrono::milliseconds(20));
  }
  std::vector<layers_t> daemons;
  for (auto& [key, layers] : received) daemons.push_back(std::move(layers));
  if (daemons.empty() && !lcm->Problem().empty()) return Unavailable("{}", lcm->Problem());
  if (daemons.empty()) {
    std::string disbelieved;
    for (const auto& [code, messages] : admission.disbelieved()) {
      disbelieved += " Not believed: " + messages.why;
    }
    return NotFound(
        "no layers were received on {}_LAYERS in {:g} s; is splinemapd{} on this LCM bus, with "
        "this channel_prefix?{}",
        bus.channel_prefix, bus.timeout_s, robot.empty() ? "" : " of " + robot, disbelieved);
  }
  return daemons;
}

}  // namespace splinemap
