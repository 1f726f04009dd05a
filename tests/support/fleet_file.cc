// fleet_file URL MAP ROBOT OUT: writes the copy of a robot's map file that a fleet has.
#include "lib/fleet/fleet_file.h"

#include <cstdio>
#include <optional>

#include "lib/base/status.h"
#include "lib/fleet/fleet_key.h"
#include "lib/fleet/nats_fleet_store.h"

namespace splinemap {
namespace {

absl::Status Get(const FleetAddress& fleet, const std::string& robot, const std::string& path) {
  SPLINEMAP_ASSIGN_OR_RETURN(const auto store, NatsFleetStore::Connect(fleet));
  std::optional<LayerId> id;
  SPLINEMAP_RETURN_IF_ERROR(store->List("layers.*.*.digest", false, [&](const FleetEntry& entry) {
    const FleetKey key = ParseFleetKey(entry.key);
    if (key.layer.name == robot) id = key.layer;
  }));
  if (!id) return NotFound("the fleet has no layer of {}", robot);
  SPLINEMAP_ASSIGN_OR_RETURN(const auto files, NatsFleetStore::Connect(FilesOf(fleet)));
  return GetFleetFile(*files, *id, path);
}

}  // namespace
}  // namespace splinemap

int main(int argc, char** argv) {
  if (argc != 5) return 2;
  splinemap::FleetAddress fleet;
  fleet.servers = argv[1];
  fleet.map = argv[2];
  fleet.program = "fleet_file";
  const absl::Status status = splinemap::Get(fleet, argv[3], argv[4]);
  if (!status.ok()) std::fprintf(stderr, "%s\n", splinemap::ErrorText(status).c_str());
  return status.ok() ? 0 : 1;
}
