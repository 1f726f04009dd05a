#include <CLI/App.hpp>
#include <cstdio>
#include <memory>
#include <nlohmann/json.hpp>

#include "clients/splinemap/commands.h"
#include "clients/splinemap/files.h"
#include "clients/splinemap/layer_name.h"
#include "clients/splinemap/print.h"
#include "clients/splinemap/progress.h"
#include "lib/base/status.h"
#include "lib/mapping/fold.h"
#include "splinemap/file.h"

namespace splinemap {
namespace {

absl::StatusOr<int> Verify(const std::string& path, bool as_json) {
  SPLINEMAP_ASSIGN_OR_RETURN(const LoadedMap loaded, ReadMapFile(path));
  int status = ReportCorruption(loaded);
  nlohmann::json json = {{"corruption", loaded.corruption}, {"layers", nlohmann::json::array()}};
  for (const LayerSnapshot& layer : loaded.set.layers) {
    std::string text;
    nlohmann::json row = {{"layer", NameOf(layer.id)}, {"scans", 0}};
    if (layer.archive == nullptr || layer.archive->num_scans() == 0) {
      row["differing_tiles"] = nullptr;
      text = fmt::format("{} tiles, no scans to compare them with", layer.tiles.size());
    } else {
      const ScanArchive& archive = *layer.archive;
      ProgressBar bar("folding " + layer.id.name);
      Fold fold(archive, loaded.set.options);
      SPLINEMAP_RETURN_IF_ERROR(fold.Continue(archive, [&](int64_t done) {
        bar.Show(static_cast<double>(done) / static_cast<double>(archive.num_scans()));
        return false;
      }));
      bar.Hide();
      const size_t differing = DifferentTiles(layer.tiles, fold.Tiles()).size();
      row["scans"] = archive.num_scans();
      row["scans_in_base"] = archive.base.scans;
      row["differing_tiles"] = differing;
      if (differing > 0) status = kFailed;
      const std::string base =
          archive.base.IsEmpty() ? ""
          : archive.base.scans > 0
              ? fmt::format(", on the tiles of {} older ones", archive.base.scans)
              : ", on tiles of older ones";
      text = differing == 0 ? fmt::format("its {} tiles are what its {} scans make{}",
                                          layer.tiles.size(), archive.num_scans(), base)
                            : fmt::format(
                                  "{} tiles differ from what its {} scans make{}; splinemap fold "
                                  "makes them anew",
                                  differing, archive.num_scans(), base);
    }
    json["layers"].push_back(row);
    if (!as_json) PrintLine(stdout, "{}: {}", NameOf(layer.id), text);
  }
  if (as_json) PrintJson(json);
  return status;
}

}  // namespace

void AddVerify(CLI::App& app, Command& chosen) {
  struct VerifyFlags {
    std::string map;
    bool json = false;
  };
  auto flags = std::make_shared<VerifyFlags>();
  CLI::App* command =
      app.add_subcommand("verify", "Check that a map is what its scans make, byte for byte");
  command->footer(
      "\nExample:\n  splinemap verify lab.splinemap\n\nExit status: 0 it is, 1 it is not, or the "
      "file is damaged.");
  command->add_option("MAP", flags->map, "Map file")->required();
  AddJsonFlag(*command, flags->json);
  command->callback(
      [flags, &chosen] { chosen = [flags] { return Verify(flags->map, flags->json); }; });
}

}  // namespace splinemap
