#include "clients/splinemap/live_layers.h"

#include <map>
#include <memory>
#include <optional>
#include <utility>

#include "clients/splinemap/layer_name.h"
#include "lcmtypes/splinemap/layer_digest_t.hpp"
#include "lib/base/clock.h"
#include "lib/base/status.h"
#include "lib/layers/validity.h"
#include "lib/wire/decode.h"
#include "lib/wire/lcm_bus.h"

namespace splinemap {

absl::StatusOr<std::vector<layers_t>> ReceiveLayers(const BusFlags& bus, const std::string& robot) {
  SPLINEMAP_ASSIGN_OR_RETURN(const std::unique_ptr<LcmBus> lcm, LcmBus::Open(bus.lcm_url));
  std::map<std::pair<std::string, int64_t>, layers_t> received;
  lcm->Subscribe(bus.channel_prefix + "_LAYERS",
                 [&](const std::string&, absl::Span<const uint8_t> message) {
                   auto layers = Decode<layers_t>(message);
                   if (!layers.ok() || (!robot.empty() && layers->name != robot)) return;
                   received[{layers->name, layers->daemon_nonce}] = *layers;
                 });
  const auto end = Clock::now() + bus.Timeout();
  while (Clock::now() < end) lcm->Handle(std::chrono::milliseconds(20));
  std::vector<layers_t> daemons;
  for (auto& [key, layers] : received) daemons.push_back(std::move(layers));
  if (daemons.empty() && !lcm->Problem().empty()) return Unavailable("{}", lcm->Problem());
  if (daemons.empty()) {
    return NotFound(
        "no layers were received on {}_LAYERS in {:g} s; is splinemapd{} on this LCM bus, with "
        "this channel_prefix?",
        bus.channel_prefix, bus.timeout_s, robot.empty() ? "" : " of " + robot);
  }
  return daemons;
}

absl::StatusOr<double> ReceiveKnotInterval(const BusFlags& bus, const LayerId& id) {
  SPLINEMAP_ASSIGN_OR_RETURN(const std::unique_ptr<LcmBus> lcm, LcmBus::Open(bus.lcm_url));
  std::optional<double> knot_m;
  lcm->Subscribe(bus.channel_prefix + "_DIGESTS",
                 [&](const std::string&, absl::Span<const uint8_t> message) {
                   const auto digest = Decode<layer_digest_t>(message);
                   if (!digest.ok() || digest->layer.name != id.name ||
                       static_cast<uint64_t>(digest->layer.origin) != id.origin) {
                     return;
                   }
                   const MapOptions options{digest->knot_interval_m, {}};
                   if (CheckMapOptions(options).ok()) knot_m = options.knot_interval_m;
                 });
  const auto end = Clock::now() + bus.Timeout();
  while (!knot_m && Clock::now() < end) lcm->Handle(std::chrono::milliseconds(20));
  if (knot_m) return *knot_m;
  return NotFound(
      "no digest of {} was received in {:g} s, which has its knot interval; give the shift in knot "
      "intervals, or --timeout more time",
      NameOf(id), bus.timeout_s);
}

}  // namespace splinemap
