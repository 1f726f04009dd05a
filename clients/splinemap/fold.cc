#include <CLI/App.hpp>
#include <cstdio>
#include <memory>
#include <string>

#include "clients/splinemap/commands.h"
#include "clients/splinemap/files.h"
#include "clients/splinemap/print.h"
#include "clients/splinemap/refold.h"
#include "lib/config/region_flag.h"
#include "clients/splinemap/time_flag.h"
#include "lib/base/status.h"
#include "lib/config/config.h"
#include "splinemap/file.h"
#include "splinemap/region.h"
#include "splinemap/scan_archive.h"

namespace splinemap {
namespace {

struct FoldFlags {
  std::string map;
  Output output;
  bool accepts_corrupt = false;
  config::Method method;
  double knot_interval_m = 0;
  std::string preset, update, until, from, without_region;
  int64_t every_nth = 1;
};

bool IsInside(const Region& region, const FixedPose2& pose) {
  const Eigen::Vector2d p = pose.ToPose().position_m;
  return p.x() >= region.x0_m && p.x() <= region.x1_m && p.y() >= region.y0_m &&
         p.y() <= region.y1_m;
}

// Which scans stay.
absl::StatusOr<ArchiveEdit> EditFor(const FoldFlags& flags, const LayerSet& set,
                                    const ScanArchive& archive) {
  ArchiveEdit edit;
  if (!flags.from.empty()) {
    SPLINEMAP_ASSIGN_OR_RETURN(const Utime from, ParseTime(flags.from, set));
    SPLINEMAP_ASSIGN_OR_RETURN(edit, ForgetBefore(archive, from));
  }
  if (!flags.until.empty()) {
    SPLINEMAP_ASSIGN_OR_RETURN(const Utime until, ParseTime(flags.until, set));
    if (edit.keeps_base) SPLINEMAP_RETURN_IF_ERROR(WindBackTo(archive, until).status());
    edit.is_kept = [until, before = edit.is_kept](const ScanPose& pose) {
      return pose.utime <= until && (!before || before(pose));
    };
  }
  SPLINEMAP_ASSIGN_OR_RETURN(const auto region, ParseRegion(flags.without_region));
  if (edit.keeps_base && !archive.base.IsEmpty() && (region || flags.every_nth > 1)) {
    return FailedPrecondition(
        "its oldest scans are not kept any more, so none of them can be left out; leave out all "
        "with --from start");
  }
  if (region) {
    edit.is_kept = [region = *region, map_T_world = archive.map_T_world,
                    before = edit.is_kept](const ScanPose& pose) {
      return !IsInside(region, Placed(map_T_world, pose.world_T_robot)) &&
             (!before || before(pose));
    };
  }
  if (flags.every_nth > 1) {
    edit.is_kept = [n = flags.every_nth, k = std::make_shared<int64_t>(0),
                    before = edit.is_kept](const ScanPose& pose) {
      return (!before || before(pose)) && (*k)++ % n == 0;
    };
  }
  return edit;
}

absl::StatusOr<int> FoldMap(FoldFlags flags) {
  if (flags.output.path.empty()) return InvalidArgument("give the map file to write with --out");
  SPLINEMAP_RETURN_IF_ERROR(CheckMapOutput(flags.output, {flags.map}));
  SPLINEMAP_ASSIGN_OR_RETURN(LoadedMap loaded, ReadInput(flags.map, flags.accepts_corrupt));
  LayerSet& set = loaded.set;
  const LayerSet times = set;  // of all scans
  std::optional<MapOptions> options;
  if (!flags.preset.empty()) flags.method.set_preset(flags.preset);
  if (!flags.update.empty()) flags.method.set_update(flags.update);
  if (flags.knot_interval_m > 0) {
    flags.method.set_knot_interval_m(flags.knot_interval_m);
  } else {
    flags.method.set_knot_interval_m(set.options.knot_interval_m);
  }
  const bool has_other_model = !flags.preset.empty() || !flags.update.empty();
  if (has_other_model || flags.knot_interval_m > 0) {
    options = MapOptionsOf(flags.method);
    if (!has_other_model) options->limits = set.options.limits;
  }
  if (has_other_model) {
    for (LayerSnapshot& layer : set.layers) {
      if (layer.archive == nullptr) continue;
      auto archive = std::make_shared<ScanArchive>();
      archive->map_T_world = layer.archive->map_T_world;
      archive->base = layer.archive->base;
      layer.archive->ForEach([&](const PosedScan& scan, const BeamModelOptions&) {
        archive->Add(std::make_shared<PosedScan>(scan), BeamModelOptionsOf(flags.method));
      });
      layer.archive = std::move(archive);
    }
  }
  SPLINEMAP_RETURN_IF_ERROR(Refold(
      set, {}, [&](const ScanArchive& archive) { return EditFor(flags, times, archive); },
      options));
  int64_t scans = 0;
  size_t tiles = 0;
  for (const LayerSnapshot& layer : set.layers) {
    scans += layer.archive == nullptr ? 0 : layer.archive->num_scans();
    tiles += layer.tiles.size();
  }
  if (tiles == 0) return FailedPrecondition("no scan of {} is left", flags.map);
  SPLINEMAP_RETURN_IF_ERROR(SaveAs(set, flags.output.path));
  PrintLine(stderr, "{} scans, {} tiles in {}", scans, tiles, flags.output.path);
  return loaded.corruption.empty() ? kSuccess : kFailed;
}

constexpr const char* kFoldExamples = R"(
Examples:
  splinemap fold drive.splinemap --knot-interval-m 0.02 --out fine.splinemap
  splinemap fold drive.splinemap --from start+1m --until end-10s --out middle.splinemap
  splinemap fold drive.splinemap --without-region 4,0,8,3 --out without_the_hall.splinemap
  splinemap fold drive.splinemap --preset paper --out paper.splinemap

Makes the map anew from the scans that it keeps, exactly as if it had been mapped so.)";

}  // namespace

void AddFold(CLI::App& app, Command& chosen) {
  auto flags = std::make_shared<FoldFlags>();
  CLI::App* command = app.add_subcommand("fold", "Make a map anew from its scans");
  command->footer(std::string(kFoldExamples) + kTimeFooter);
  command->add_option("MAP", flags->map, "Map file")->required();
  AddOutOption(*command, "Map file to write", flags->output);
  command->add_option("--knot-interval-m", flags->knot_interval_m, "Another resolution")
      ->check(CLI::Range(0.005, 10.0));
  command->add_option("--preset", flags->preset, "Another sensor model")
      ->check(CLI::IsMember({"default", "paper"}));
  command->add_option("--update", flags->update, "What a beam adds")
      ->check(CLI::IsMember({"signed_distance", "paper_samples", "paper_line"}));
  command->add_option("--from", flags->from, "Scans from this time on alone")->type_name("TIME");
  command->add_option("--until", flags->until, "Scans up to this time alone")->type_name("TIME");
  command
      ->add_option("--without-region", flags->without_region,
                   "Leave out the scans that the robot made from there")
      ->type_name("X0,Y0,X1,Y1");
  command->add_option("--every-nth", flags->every_nth, "The first scan, and then every n-th")
      ->check(CLI::Range(int64_t{1}, int64_t{1'000'000}));
  AddCorruptFlag(*command, flags->accepts_corrupt);
  command->callback([flags, &chosen] { chosen = [flags] { return FoldMap(*flags); }; });
}

}  // namespace splinemap
