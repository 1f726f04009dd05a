#pragma once

#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "clients/splinemap/map_source.h"
#include "lib/fleet/fleet_store.h"
#include "splinemap/fixed_pose2.h"
#include "splinemap/layer_command.h"

namespace splinemap {

// Changes the settings of a layer of a file; `placement` is for kPlace, which makes the layer anew
// where all of its scans are there.
absl::Status EditLayer(LayerCommand command, const Pose2& placement, const LayerId& id,
                       LayerSet& set);

// A layer on a bus.
struct LiveLayer {
  std::string daemon;  // its owner's, or else one that has it
  LayerId id;
  uint64_t session_number = 0;
  FixedPose2 on_read;    // of its settings
  FixedPose2 placement;  // as PlacementOf()
};
// Those that `names` name; InvalidArgument where there is none, or several.
absl::StatusOr<std::vector<LiveLayer>> FindLiveLayers(const MapSourceFlags& source,
                                                      const std::vector<std::string>& names);
absl::Status EditLiveLayer(const BusFlags& bus, const LiveLayer& layer, LayerCommand command,
                           const Pose2& placement);

// A layer of a fleet.
struct FleetLayer {
  LayerId id;
  SessionId session;
  FixedPose2 placement;
};
// As FindLiveLayers().
absl::StatusOr<std::vector<FleetLayer>> FindFleetLayers(FleetStore& store,
                                                        const std::vector<std::string>& names);
// Places it only where it is still placed as `layer` says; FailedPrecondition elsewhere.
absl::Status EditFleetLayer(FleetStore& store, const FleetLayer& layer, LayerCommand command,
                            const Pose2& placement);

}  // namespace splinemap
