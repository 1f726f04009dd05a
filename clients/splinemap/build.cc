#include <sched.h>

#include <CLI/App.hpp>
#include <algorithm>
#include <cstdio>
#include <map>
#include <memory>
#include <utility>

#include "clients/splinemap/commands.h"
#include "clients/splinemap/files.h"
#include "clients/splinemap/print.h"
#include "clients/splinemap/progress.h"
#include "lib/base/random.h"
#include "lib/base/status.h"
#include "lib/config/flags.h"
#include "lib/diagnosis/proposal.h"
#include "lib/diagnosis/survey.h"
#include "lib/logs/lcm_log.h"
#include "lib/pipeline/mapper.h"
#include "lib/wire/message_type.h"
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

ScanArchive EmptyArchive(const config::Config& config) {
  ScanArchive archive;
  archive.map_T_world = FrameOf(config);
  return archive;
}

// On one core, two threads would take turns in its caches.
bool HasSecondCore() {
  cpu_set_t cores;
  return sched_getaffinity(0, sizeof(cores), &cores) == 0 && CPU_COUNT(&cores) > 1;
}

// A log, mapped.
struct MappedLog {
  MappedLog(const config::Config& config, LayerId id, SessionId session)
      : options(MapOptionsOf(config.method())),
        layer(std::move(id), session),
        mapper(config, options, layer, EmptyArchive(config)) {
    if (HasSecondCore()) mapper.MapBeside();
  }

  MapOptions options;
  Layer layer;
  Mapper mapper;
  absl::Status read;  // what ReadLcmLog() says
};

// Compares the pose channel with the others of the log, once, after the first scans.
class PoseWatch {
 public:
  PoseWatch(const std::string& log, const config::Config& config) : log_(log), config_(config) {}

  void Add(const LogEvent& event) {
    if (is_done_) return;
    survey_.Add(event.utime, event.channel, event.message);
    scans_ += event.channel == config_.scan(0).channel();
    if (scans_ == kScans) Compare();
  }

  void Compare() {
    if (std::exchange(is_done_, true)) return;
    const std::string sharper = SharperPoses(survey_, config_);
    if (!sharper.empty()) PrintLine(stderr, "{}. See splinemap doctor {}", sharper, log_);
  }

 private:
  static constexpr int kScans = 300;

  std::string log_;
  config::Config config_;
  Survey survey_;
  int scans_ = 0;
  bool is_done_ = false;
};

std::unique_ptr<MappedLog> MapInOrderOfFile(const std::string& log, const config::Config& config,
                                            std::unique_ptr<MappedLog> drive) {
  PoseWatch poses(log, config);
  ProgressBar bar("mapping");
  drive->read = ReadLcmLog(
      log,
      [&](const LogEvent& event) {
        drive->mapper.HandleMessage(event.channel, event.message, event.utime);
        poses.Add(event);
      },
      [&](double share) { bar.Show(share); });
  drive->mapper.Flush();
  poses.Compare();
  return drive;
}

// By the stamps of messages, on the clock of the poses.
std::unique_ptr<MappedLog> MapInOrderOfStamps(const std::string& log, const config::Config& config,
                                              std::unique_ptr<MappedLog> drive) {
  std::map<std::string, SensorOptions> scans;
  for (const config::Scan& scan : config.scan()) {
    scans[scan.channel()] = SensorOptionsOf(scan, "bot_core");
  }
  const auto time_of = [&](const LogEvent& event) {
    constexpr size_t kBytesWithStamp = 16;
    if (!TypeOf(event.message) || event.message.size() < kBytesWithStamp) return Utime(0);
    const auto options = scans.find(event.channel);
    const bool is_scan = options != scans.end();
    const Utime utime =
        is_scan && options->second.stamp_is_receipt ? event.utime : UtimeOf(event.message);
    if (!CheckUtime(utime.count()).ok()) return Utime(0);
    return is_scan ? utime + options->second.time_offset : utime;
  };
  ProgressBar bar("mapping in order of message time");
  drive->read = ReadLcmLogInOrder(
      log, drive->mapper.channels(), time_of,
      [&](const LogEvent& event) {
        drive->mapper.HandleMessage(event.channel, event.message, event.utime);
      },
      [&](double share) { bar.Show(share); });
  drive->mapper.Flush();
  return drive;
}

// More than a few at the beginning and the end.
bool LacksPoses(const MapperCounts& counts) {
  const DropCounts& drops = counts.drops;
  const int64_t lacking = drops[DropReason::kScanWithoutPose] + drops[DropReason::kScanQueueFull] +
                          drops[DropReason::kScanInPoseGap];
  return lacking * 100 > counts.scans_received && counts.poses_received > 0;
}

double ShareOfBeams(const MapperCounts& counts) {
  return static_cast<double>(counts.beams_mapped) /
         static_cast<double>(std::max<int64_t>(counts.beams_received, 1));
}

void ReportMapped(const MapperCounts& counts, size_t tiles, const std::string& out) {
  PrintLine(stderr,
            "mapped {} of {} scans with {} poses, {:.0f} % of their readings; {} tiles in {}",
            counts.scans_mapped, counts.scans_received, counts.poses_received,
            100 * ShareOfBeams(counts), tiles, out);
}

absl::StatusOr<int> Build(const BuildFlags& flags) {
  SPLINEMAP_RETURN_IF_ERROR(CheckMapOutput(flags.output, {flags.log}));
  SPLINEMAP_ASSIGN_OR_RETURN(config::Config config, ConfigOf(flags.input));
  if (config.scan_size() == 0 || config.pose().empty()) {
    ProgressBar bar("looking for scans and poses");
    const auto show = [&](double share) { bar.Show(share); };
    std::string damage;  // which is reported when the log is mapped
    SPLINEMAP_ASSIGN_OR_RETURN(const Survey survey,
                               SurveyLog(flags.log, SurveyDepth::kTypes, show, damage));
    SPLINEMAP_RETURN_IF_ERROR(ChooseChannels(survey, config));
  }
  SPLINEMAP_RETURN_IF_ERROR(CheckConfig(config));

  const LayerId id{RobotName(config), RandomId()};
  const SessionId session{1, RandomId()};
  std::unique_ptr<MappedLog> drive =
      MapInOrderOfFile(flags.log, config, std::make_unique<MappedLog>(config, id, session));
  if (LacksPoses(drive->mapper.counts())) {
    auto again =
        MapInOrderOfStamps(flags.log, config, std::make_unique<MappedLog>(config, id, session));
    if (again->mapper.counts().scans_mapped > drive->mapper.counts().scans_mapped) {
      PrintLine(stderr,
                "{} has its poses long before or after its scans; they were brought together by "
                "their time stamps",
                flags.log);
      again->read = drive->read;  // of the whole log
      drive = std::move(again);
    }
  }
  for (const Notice& notice : drive->mapper.DrainNotices()) {
    PrintLine(stderr, "{}", notice.text);
  }
  const MapperCounts counts = drive->mapper.counts();
  if (!drive->read.ok()) PrintLine(stderr, "{}", ErrorText(drive->read));
  ReportDrops(counts.drops);
  if (counts.scans_received == 0 || counts.poses_received == 0) {
    std::string damage;  // is reported already
    SPLINEMAP_ASSIGN_OR_RETURN(const Survey survey,
                               SurveyLog(
                                   flags.log, SurveyDepth::kTypes, [](double) {}, damage));
    SPLINEMAP_RETURN_IF_ERROR(ChooseChannels(survey, config));
  }
  if (counts.scans_mapped == 0) {
    return FailedPrecondition(
        "no scan of {} was mapped; {} scans and {} poses are on {}. See splinemap doctor {}",
        flags.log, counts.scans_received, counts.poses_received,
        fmt::join(drive->mapper.channels(), ", "), flags.log);
  }
  if (drive->layer.tiles().size() == 0) {
    return FailedPrecondition(
        "{} scans of {} were mapped and say nothing: none of their {} readings is used. See "
        "splinemap doctor {}",
        counts.scans_mapped, flags.log, counts.beams_received, flags.log);
  }
  SPLINEMAP_RETURN_IF_ERROR(
      SaveAs({.options = drive->options, .layers = {drive->mapper.Snapshot()}}, flags.output.path));
  ReportMapped(counts, drive->layer.tiles().size(), flags.output.path);
  return drive->read.ok() ? kSuccess : kFailed;
}

constexpr const char* kBuildExamples = R"(
Examples:
  splinemap build drive.lcmlog drive.splinemap
  splinemap build lab.lcmlog lab.splinemap --scan LIDAR:michigan_2017 --pose SLAM_POSE

Maps as splinemapd does, without a network. Channels that are not given are chosen by their type.
Messages are taken in the order of the log, and in that of their time stamps where the log has poses
long before or after their scans.)";

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
