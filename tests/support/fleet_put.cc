// fleet_put MAP URL NAME: makes the map NAME of a fleet have the layers of a map file and their
// settings, as the robots' uplinks do; those that are there already stay.
// fleet_put MAP URL NAME torn: and takes some tiles out of the first layer.
// fleet_put MAP URL NAME file [FILE]: brings MAP, or FILE, as the copy of the map file of the robot
// of MAP's first layer, and nothing else.
// fleet_put MAP URL NAME damaged: and takes a part of the copy away.
#include <cstdio>
#include <string>

#include "lib/base/host_clock.h"
#include "lib/base/status.h"
#include "lib/fleet/fleet_file.h"
#include "lib/fleet/fleet_settings.h"
#include "lib/fleet/layer_digest.h"
#include "lib/fleet/layer_upload.h"
#include "lib/fleet/nats_fleet_store.h"
#include "splinemap/file.h"

namespace splinemap {
namespace {

absl::Status PutLayers(const std::string& path, const FleetAddress& fleet) {
  SPLINEMAP_ASSIGN_OR_RETURN(const LoadedMap loaded, ReadMapFile(path));
  SPLINEMAP_ASSIGN_OR_RETURN(const auto store, NatsFleetStore::Connect(fleet));
  SPLINEMAP_RETURN_IF_ERROR(store->MakeBucket(/*replicas=*/1));
  FleetEntry map;
  map.key = kMapKey;
  map.value = EncodeMapOptions(loaded.set.options);
  map.hash = 1;
  const absl::Status put = store->PutIf(map, 0).status();
  if (!put.ok() && !absl::IsAborted(put)) return put;
  for (const LayerSnapshot& layer : loaded.set.layers) {
    LayerUpload upload(*store, layer.id, loaded.set.options);
    SPLINEMAP_RETURN_IF_ERROR(upload.Bring(layer, [](int64_t) { return true; }));
  }
  for (const auto& [id, settings] : loaded.set.settings.records()) {
    SPLINEMAP_RETURN_IF_ERROR(ChangeSettings(*store, id, [&](LayerSettings& stored) {
      stored = settings;
      return absl::OkStatus();
    }));
  }
  return absl::OkStatus();
}

absl::Status PutFile(const std::string& map, const std::string& path, const FleetAddress& fleet) {
  SPLINEMAP_ASSIGN_OR_RETURN(const LoadedMap loaded, ReadMapFile(map));
  SPLINEMAP_ASSIGN_OR_RETURN(const auto files, NatsFleetStore::Connect(FilesOf(fleet)));
  SPLINEMAP_RETURN_IF_ERROR(files->MakeBucket(/*replicas=*/1));
  FleetFileUpload upload(*files, loaded.set.layers.front().id, path, HostUtime());
  return upload.Bring([](int64_t) { return true; });
}

// Takes one of these entries away.
absl::Status Tear(const FleetAddress& fleet, const std::string& filter) {
  SPLINEMAP_ASSIGN_OR_RETURN(const auto store, NatsFleetStore::Connect(fleet));
  std::string key;
  SPLINEMAP_RETURN_IF_ERROR(store->List(filter, false, [&](const FleetEntry& entry) {
    if (key.empty()) key = entry.key;
  }));
  FleetEntry gone;
  gone.key = key;
  return store->Put({gone});
}

}  // namespace
}  // namespace splinemap

int main(int argc, char** argv) {
  if (argc < 4 || argc > 6) return 2;
  splinemap::FleetAddress fleet;
  fleet.servers = argv[2];
  fleet.map = argv[3];
  fleet.program = "fleet_put";
  const std::string what = argc > 4 ? argv[4] : "";
  const bool is_file = what == "file" || what == "damaged";
  absl::Status status = is_file ? splinemap::PutFile(argv[1], argc > 5 ? argv[5] : argv[1], fleet)
                                : splinemap::PutLayers(argv[1], fleet);
  if (status.ok() && what == "torn") status = splinemap::Tear(fleet, "layers.*.*.tiles.>");
  if (status.ok() && what == "damaged") {
    status = splinemap::Tear(splinemap::FilesOf(fleet), "layers.*.*.chunk.>");
  }
  if (!status.ok()) std::fprintf(stderr, "%s\n", splinemap::ErrorText(status).c_str());
  return status.ok() ? 0 : 1;
}
