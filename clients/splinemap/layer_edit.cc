#include "clients/splinemap/layer_edit.h"

#include <map>
#include <memory>

#include "clients/splinemap/layer_name.h"
#include "clients/splinemap/layer_rows.h"
#include "clients/splinemap/live_layers.h"
#include "clients/splinemap/print.h"
#include "clients/splinemap/refold.h"
#include "lcmtypes/splinemap/layer_status_t.hpp"
#include "lib/base/random.h"
#include "lib/base/status.h"
#include "lib/fleet/fleet_key.h"
#include "lib/fleet/fleet_settings.h"
#include "lib/fleet/layer_digest.h"
#include "lib/layers/layer_edits.h"
#include "splinemap/client.h"

namespace splinemap {
namespace {

// Makes the layer anew from its scans, where all of them are there. The placement that is left to
// those who read it.
absl::StatusOr<FixedPose2> PlaceExactly(const FixedPose2& placement, const LayerId& id,
                                        LayerSet& set) {
  const std::shared_ptr<const ScanArchive> archive = set.Find(id)->archive;
  if (archive == nullptr) return placement;
  if (archive->num_scans() == 0 || !archive->base.IsEmpty()) {
    return placement / archive->map_T_world;
  }
  SPLINEMAP_RETURN_IF_ERROR(
      Refold(set, {NameOf(id)}, [&](const ScanArchive&) -> absl::StatusOr<ArchiveEdit> {
        ArchiveEdit edit;
        edit.map_T_world = placement;
        return edit;
      }));
  return FixedPose2();
}

absl::StatusOr<std::vector<LiveLayer>> ReceiveNamedLayers(const MapSourceFlags& source,
                                                          const std::vector<std::string>& names) {
  SPLINEMAP_ASSIGN_OR_RETURN(const std::vector<layers_t> daemons,
                             ReceiveLayers(source.bus, source.robot));
  std::map<LayerId, LiveLayer> received;
  for (const layers_t& daemon : daemons) {
    for (const layer_status_t& layer : daemon.layers) {
      if (layer.state == "removed") continue;
      const LayerRow row = RowOf(layer);
      const LiveLayer here{daemon.name, row.id, static_cast<uint64_t>(layer.session_number),
                           row.settings.placement, row.placement};
      // Its owner places it exactly.
      const bool is_owner = &layer == &daemon.layers.front() && layer.state == "own";
      if (is_owner) received.insert_or_assign(row.id, here);
      received.try_emplace(row.id, here);
    }
  }
  std::vector<LayerId> candidates;
  for (const auto& [id, layer] : received) candidates.push_back(id);
  const std::string where = source.robot.empty() ? "the bus" : "the daemon of " + source.robot;
  std::vector<LiveLayer> found;
  for (const std::string& text : names) {
    SPLINEMAP_ASSIGN_OR_RETURN(const LayerId id, FindLayer(candidates, text, where));
    found.push_back(received.at(id));
  }
  return found;
}

}  // namespace

absl::Status EditLayer(LayerCommand command, const Pose2& placement, const LayerId& id,
                       LayerSet& set) {
  LayerSettings settings = set.settings.Next(id, RandomId());
  if (command == LayerCommand::kRemove) {
    SPLINEMAP_ASSIGN_OR_RETURN(set, WithoutLayers(set, {id}, RandomId()));
    return absl::OkStatus();
  }
  FixedPose2 on_read = FixedPose2::Nearest(placement);
  if (command == LayerCommand::kPlace) {
    SPLINEMAP_ASSIGN_OR_RETURN(on_read, PlaceExactly(on_read, id, set));
  }
  Apply(command, on_read, set.Find(id)->session, settings);
  if (!set.settings.Merge(id, settings)) {
    return FailedPrecondition("the map has no room for settings of another layer");
  }
  return absl::OkStatus();
}

absl::StatusOr<std::vector<LiveLayer>> FindLiveLayers(const MapSourceFlags& source,
                                                      const std::vector<std::string>& names) {
  absl::StatusOr<std::vector<LiveLayer>> layers = ReceiveNamedLayers(source, names);
  // Messages may be lost.
  for (int n = 0; n < 3 && !layers.ok(); ++n) layers = ReceiveNamedLayers(source, names);
  return layers;
}

absl::Status EditLiveLayer(const BusFlags& bus, const LiveLayer& layer, LayerCommand command,
                           const Pose2& placement) {
  ClientOptions options;
  options.channel_prefix = bus.channel_prefix;
  options.robot = layer.daemon;
  SPLINEMAP_ASSIGN_OR_RETURN(options.keys, bus.Keys());
  SPLINEMAP_ASSIGN_OR_RETURN(const auto client, MapClient::Connect(bus.lcm_url, options));
  SPLINEMAP_RETURN_IF_ERROR(client->Set({command, layer.id, layer.session_number, placement}));
  PrintLine(stderr, "{} {}: saved by the daemon of {}; the others follow within 2 s",
            NameOf(command), NameOf(layer.id), layer.daemon);
  return absl::OkStatus();
}

absl::StatusOr<std::vector<FleetLayer>> FindFleetLayers(FleetStore& store,
                                                        const std::vector<std::string>& names) {
  std::vector<LayerId> ids;
  SPLINEMAP_RETURN_IF_ERROR(
      store.List("layers.*.*.digest", /*with_values=*/false, [&](const FleetEntry& entry) {
        const FleetKey key = ParseFleetKey(entry.key);
        if (key.kind == FleetKey::Kind::kDigest && entry.hash != 0) ids.push_back(key.layer);
      }));
  std::vector<FleetLayer> found;
  for (const std::string& text : names) {
    SPLINEMAP_ASSIGN_OR_RETURN(const LayerId id, FindLayer(ids, text, "the fleet's map"));
    SPLINEMAP_ASSIGN_OR_RETURN(const FleetEntry entry, store.Get(DigestKey(id)));
    SPLINEMAP_ASSIGN_OR_RETURN(const LayerDigest digest, DecodeDigest(entry.value, id));
    SPLINEMAP_ASSIGN_OR_RETURN(const LayerSettings settings, ReadSettings(store, id));
    found.push_back({id, digest.session, settings.placement});
  }
  return found;
}

absl::Status EditFleetLayer(FleetStore& store, const FleetLayer& layer, LayerCommand command,
                            const Pose2& placement) {
  SPLINEMAP_RETURN_IF_ERROR(
      ChangeSettings(store, layer.id, [&](LayerSettings& settings) -> absl::Status {
        if (command == LayerCommand::kPlace && settings.placement != layer.placement) {
          return FailedPrecondition("{} was placed meanwhile, so nothing was placed; try again",
                                    NameOf(layer.id));
        }
        Apply(command, FixedPose2::Nearest(placement), layer.session, settings);
        return absl::OkStatus();
      }));
  PrintLine(stderr, "{} {}: stored by the fleet; robots follow when they are connected",
            NameOf(command), NameOf(layer.id));
  return absl::OkStatus();
}

}  // namespace splinemap
