#include <CLI/App.hpp>
#include <cstdio>
#include <memory>

#include "clients/splinemap/commands.h"
#include "clients/splinemap/files.h"
#include "clients/splinemap/print.h"
#include "clients/splinemap/progress.h"
#include "lib/base/random.h"
#include "lib/base/status.h"
#include "lib/config/flags.h"
#include "lib/diagnosis/survey.h"
#include "lib/logs/lcm_log.h"
#include "lib/pipeline/mapper.h"
#include "splinemap/file.h"
#include "splinemap/map_view.h"

namespace splinemap {
namespace {

struct BuildFlags {
  std::string log;
  Output output;
  InputFlags input;
};

void ReportDrops(const DropCounts& drops) {
  for (int k = 0; k < kNumDropReasons; ++k) {
    const auto reason = static_cast<DropReason>(k);
    if (drops[reason] == 0) continue;
    PrintLine(stderr, "dropped {} {}: {}", drops[reason], DropName(reason),
              DropExplanation(reason));
  }
}

void ReportMapped(const MapperCounts& counts, size_t tiles, const std::string& out) {
  PrintLine(stderr, "mapped {} of {} scans with {} poses; {} tiles in {}", counts.scans_mapped,
            counts.scans_received, counts.poses_received, tiles, out);
}

absl::StatusOr<int> Build(const BuildFlags& flags) {
  SPLINEMAP_RETURN_IF_ERROR(CheckMapOutput(flags.output, {flags.log}));
  SPLINEMAP_ASSIGN_OR_RETURN(config::Config config, ConfigOf(flags.input));
  if (config.scan_size() == 0 || config.pose().empty()) {
    ProgressBar bar("looking for scans and poses");
    const auto show = [&](double share) { bar.Show(share); };
    std::string damage;  // which is reported when the log is mapped
    SPLINEMAP_ASSIGN_OR_RETURN(const Survey survey, SurveyLog(flags.log, show, damage));
    SPLINEMAP_RETURN_IF_ERROR(ChooseChannels(survey, config));
  }
  SPLINEMAP_RETURN_IF_ERROR(CheckConfig(config));

  const MapOptions options = MapOptionsOf(config.method());
  Layer layer(LayerId{RobotName(config), RandomId()}, {1, RandomId()});
  Mapper mapper(config, options, layer);
  absl::Status read;
  {
    ProgressBar bar("mapping");
    read = ReadLcmLog(
        flags.log,
        [&](const LogEvent& event) { mapper.HandleMessage(event.channel, event.message); },
        [&](double share) { bar.Show(share); });
  }
  mapper.Flush();
  for (const Notice& notice : mapper.DrainNotices()) {
    PrintLine(stderr, "{}", notice.text);
  }
  const MapperCounts counts = mapper.counts();
  if (!read.ok()) PrintLine(stderr, "{}", ErrorText(read));
  ReportDrops(counts.drops);
  if (counts.scans_mapped == 0) {
    return FailedPrecondition(
        "no scan of {} was mapped; {} scans and {} poses are on {}. See splinemap doctor {}",
        flags.log, counts.scans_received, counts.poses_received, fmt::join(mapper.channels(), ", "),
        flags.log);
  }
  SPLINEMAP_RETURN_IF_ERROR(
      SaveAs({.options = options, .layers = {layer.Snapshot()}}, flags.output.path));
  ReportMapped(counts, layer.tiles().size(), flags.output.path);
  return read.ok() ? kSuccess : kFailed;
}

constexpr const char* kBuildExamples = R"(
Examples:
  splinemap build drive.lcmlog drive.splinemap
  splinemap build lab.lcmlog lab.splinemap --scan LIDAR:michigan_2017 --pose SLAM_POSE

Maps as splinemapd does, without a network. Channels that are not given are chosen by their type.)";

}  // namespace

void AddBuild(CLI::App& app, Command& chosen) {
  auto flags = std::make_shared<BuildFlags>();
  CLI::App* command = app.add_subcommand("build", "Build a map from an LCM log");
  command->footer(kBuildExamples);
  command->add_option("LOG", flags->log, "LCM log, plain or gzip")->required();
  AddOutput(*command, "OUT", "Map file to write", flags->output);
  AddInputFlags(*command, flags->input);
  command->callback([flags, &chosen] { chosen = [flags] { return Build(*flags); }; });
}

}  // namespace splinemap
