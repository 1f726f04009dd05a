#include <CLI/App.hpp>
#include <cstdio>
#include <memory>
#include <string>

#include "clients/splinemap/commands.h"
#include "clients/splinemap/files.h"
#include "clients/splinemap/print.h"
#include "lib/config/region_flag.h"
#include "lib/base/random.h"
#include "lib/base/status.h"
#include "lib/map/placed_tile.h"
#include "splinemap/file.h"
#include "splinemap/tile_tree.h"

namespace splinemap {
namespace {

struct CropFlags {
  std::string map;
  std::string region;
  Output output;
  bool accepts_corrupt = false;
};

// Of each layer the tiles that have a part of the region. It becomes another layer, so that a merge
// with what it was cropped from does not bring the rest back.
LayerSet Cropped(const LayerSet& map, const Region& region) {
  LayerSet cropped;
  cropped.options = map.options;
  for (const LayerSnapshot& layer : map.layers) {
    const LayerSettings& settings = map.settings.Of(layer.id);
    const double knot_m = map.options.knot_interval_m;
    const TileBox box = TilesUnder(region, KnotPlacement(settings.placement, knot_m), knot_m);
    TileTreeEditor tiles;
    layer.tiles.ForEach([&](TileKey key, const TileTree::Entry& entry) {
      if (box.Contains(key)) tiles.Put(key, entry.tile, entry.revision);
    });
    const LayerId id{layer.id.name, RandomId()};
    cropped.layers.push_back({id, {1, RandomId()}, layer.revision, tiles.Freeze()});
    LayerSettings kept = cropped.settings.Next(id, RandomId());
    kept.muted = settings.muted;
    kept.low_weight = settings.low_weight;
    kept.placement = settings.placement;
    if (kept.muted || kept.low_weight || !kept.placement.IsIdentity())
      cropped.settings.Merge(id, kept);
  }
  return cropped;
}

absl::StatusOr<int> Crop(const CropFlags& flags) {
  SPLINEMAP_RETURN_IF_ERROR(CheckMapOutput(flags.output, {flags.map}));
  SPLINEMAP_ASSIGN_OR_RETURN(const auto region, ParseRegion(flags.region));
  SPLINEMAP_ASSIGN_OR_RETURN(const LoadedMap loaded, ReadInput(flags.map, flags.accepts_corrupt));
  const LayerSet cropped = Cropped(loaded.set, *region);
  size_t before = 0;
  size_t after = 0;
  for (size_t k = 0; k < cropped.layers.size(); ++k) {
    before += loaded.set.layers[k].tiles.size();
    after += cropped.layers[k].tiles.size();
  }
  if (after == 0) {
    return FailedPrecondition(
        "no tile of {} lies in the region; splinemap layers says where they are", flags.map);
  }
  SPLINEMAP_RETURN_IF_ERROR(SaveAs(cropped, flags.output.path));
  PrintLine(stderr, "kept {} of {} tiles in {}", after, before, flags.output.path);
  return loaded.corruption.empty() ? kSuccess : kFailed;
}

constexpr const char* kCropExamples = R"(
Example:
  splinemap crop drive.splinemap lab.splinemap --region -5,-5,20,15

Keeps the tiles, 32 x 32 knots each, that have a part of the region. The layers get another origin,
so that they are others than those that they were cropped from. They have no scans, and so cannot be
corrected.)";

}  // namespace

void AddCrop(CLI::App& app, Command& chosen) {
  auto flags = std::make_shared<CropFlags>();
  CLI::App* command = app.add_subcommand("crop", "Keep a region of a map file");
  command->footer(kCropExamples);
  command->add_option("MAP", flags->map, "Map file")->required();
  AddOutput(*command, "OUT", "Map file to write", flags->output);
  AddRegionFlag(*command, flags->region)->required();
  AddCorruptFlag(*command, flags->accepts_corrupt);
  command->callback([flags, &chosen] { chosen = [flags] { return Crop(*flags); }; });
}

}  // namespace splinemap
