// Doctor as a law: what it proposes never makes a worse map than no flags, and is mostly right. On
// simulated drives whose messages have a fault each it is judged by the truth, on recorded ones by
// the sharpness of all scans.
#include <CLI/CLI.hpp>
#include <algorithm>
#include <cstdio>
#include <filesystem>
#include <numbers>
#include <string>
#include <vector>

#include "fmt/format.h"
#include "fmt/ranges.h"
#include "lib/base/status.h"
#include "lib/config/config.h"
#include "lib/diagnosis/proposal.h"
#include "lib/logs/carmen_log.h"
#include "lib/logs/lcm_log.h"
#include "lib/pipeline/mapper.h"
#include "lib/wire/encode.h"
#include "lib/wire/sensor_messages.h"
#include "splinemap/layer_set.h"
#include "tests/soak/doctor/faulty_drive.h"
#include "tests/soak/doctor/map_truth.h"
#include "tests/support/temporary_directory.h"

namespace splinemap::doctor_law {
namespace {

// A map is as good as another one where both shares differ by no more, and worse where its score is
// less by more.
constexpr double kAsGood = 0.02;
constexpr double kWorse = 0.01;
constexpr double kSharpnessWorse = 1.001;  // times the cells
constexpr double kMostlyRight = 0.95;

struct Flags {
  int drives = 200;
  uint64_t seed = 1;
  int only = -1;
  bool table = false;
  std::string folder;
};

std::string Describe(const config::Config& config) {
  std::vector<std::string> words;
  for (const config::Scan& scan : config.scan()) words.push_back("--scan " + ScanFlagOf(scan));
  words.push_back("--pose " + config.pose());
  return fmt::format("{}", fmt::join(words, " "));
}

config::Config WithoutFlags(const std::string& scan, const std::string& pose) {
  config::Config config;
  config.add_scan()->set_channel(scan);
  config.set_pose(pose);
  return config;
}

absl::StatusOr<config::Config> ConfigOf(const Proposal& proposal) {
  config::Config config;
  for (const std::string& flag : proposal.scan_flags) {
    SPLINEMAP_ASSIGN_OR_RETURN(*config.add_scan(), ParseScanFlag(flag));
  }
  config.set_pose(proposal.pose);
  return config;
}

// What doctor proposes, searched on where it says so.
absl::StatusOr<config::Config> Ask(const Survey& survey) {
  constexpr int kMostSearches = 8;
  config::Config given;
  absl::Status problem;
  for (int k = 0; k < kMostSearches; ++k) {
    SPLINEMAP_ASSIGN_OR_RETURN(const Proposal proposal, Propose(survey, given));
    SPLINEMAP_ASSIGN_OR_RETURN(given, ConfigOf(proposal));
    if (proposal.problem.empty()) return given;
    problem = FailedPrecondition("{}", proposal.problem);
  }
  return problem;
}

std::shared_ptr<const MapView> MapWith(const std::string& log, const config::Config& config) {
  Layer layer(LayerId{"robot", 1}, SessionId{1, 1});
  const MapOptions options = MapOptionsOf(config.method());
  Mapper mapper(config, options, layer);
  const absl::Status read = ReadLcmLog(
      log,
      [&](const LogEvent& event) {
        mapper.HandleMessage(event.channel, event.message, event.utime);
      },
      [](double) {});
  mapper.Flush();
  return ViewOf({.options = options, .layers = {layer.Snapshot()}});
}

absl::StatusOr<Survey> SurveyOf(const std::string& log) {
  std::string damage;
  return SurveyLog(
      log, SurveyDepth::kAll, [](double) {}, damage);
}

std::vector<std::string> ChannelsOf(const Survey& survey, bool (*is_kind)(MessageType)) {
  std::vector<std::string> names;
  for (const SurveyedChannel& channel : survey.channels()) {
    if (channel.type && is_kind(*channel.type)) names.push_back(channel.name);
  }
  return names;
}

// For a drive whose messages are honest: what they do not tell.
config::Config RightFlags(const Fault& mended) {
  config::Config config = WithoutFlags("LASER", "POSE");
  config::Scan& scan = *config.mutable_scan(0);
  scan.set_x_m(mended.robot_T_sensor.position_m.x());
  scan.set_y_m(mended.robot_T_sensor.position_m.y());
  scan.set_yaw_deg(mended.robot_T_sensor.yaw_rad * 180 / std::numbers::pi);
  scan.set_scan_duration_ms(mended.scan_duration_s * 1000);
  return config;
}

struct Verdict {
  std::string drive;
  std::string flags{};    // or what is said in place of them
  std::string figures{};  // of both
  bool is_worse = false;
  std::string wrong{};  // why, or empty
};

std::string Percent(const Quality& quality) {
  return fmt::format("{:5.1f} {:5.1f}", 100 * quality.off, 100 * quality.found);
}

// Of a drive with a fault. Refusing is right where nothing can be mapped, with the reason.
absl::StatusOr<Verdict> Judge(int number, const Flags& flags, const std::string& log) {
  std::mt19937_64 random(flags.seed * 1'000'003 + static_cast<uint64_t>(number));
  const simulation::World world = RandomRoom(random);
  Scanner scanner = RandomScanner(random);
  const Fault fault = RandomFault(number % NumKinds(), scanner, random);
  const uint64_t noise = random();

  const Fault mended = Mended(fault);
  SPLINEMAP_RETURN_IF_ERROR(WriteDrive(world, scanner, mended, noise, log));
  const Quality honest = Compare(*MapWith(log, RightFlags(mended)), world);

  SPLINEMAP_RETURN_IF_ERROR(WriteDrive(world, scanner, fault, noise, log));
  SPLINEMAP_ASSIGN_OR_RETURN(const Survey survey, SurveyOf(log));
  Quality given;
  for (const std::string& pose : ChannelsOf(survey, &IsPose)) {
    const Quality quality = Compare(*MapWith(log, WithoutFlags("LASER", pose)), world);
    if (quality.score() > given.score()) given = quality;
  }

  Verdict verdict{.drive = fmt::format("{:4} {}", number, Describe(fault))};
  const absl::StatusOr<config::Config> config = Ask(survey);
  if (!config.ok()) {
    verdict.flags = ErrorText(config.status());
    verdict.figures = fmt::format("{} | {}", Percent(honest), Percent(given));
    const bool has_reason =
        !fault.refusal.empty() && verdict.flags.find(fault.refusal) != std::string::npos;
    if (!has_reason) verdict.wrong = "it is refused without the reason";
    return verdict;
  }
  const Quality proposed = Compare(*MapWith(log, *config), world);
  verdict.flags = Describe(*config);
  verdict.figures = fmt::format("{} | {} | {}", Percent(honest), Percent(given), Percent(proposed));
  verdict.is_worse = proposed.score() < given.score() - kWorse;
  const bool is_as_good =
      proposed.off <= honest.off + kAsGood && proposed.found >= honest.found - kAsGood;
  if (!is_as_good) verdict.wrong = "the map is not as good as without the fault";
  if (verdict.is_worse) verdict.wrong = "the map is worse than without flags";
  return verdict;
}

absl::Status ImportCarmen(const std::string& path, const std::string& log) {
  SPLINEMAP_ASSIGN_OR_RETURN(const CarmenLog carmen,
                             ReadCarmenLog(path, std::nullopt, [](double) {}));
  return WriteAsLcmLog(carmen, RepairTimes(carmen.scans, 10).utimes, log);
}

// All of a log that is mapped with the options, in the cells that its hits lie in.
SampleSpread SpreadOfAll(const std::string& log, const Survey& survey,
                         const config::Config& config) {
  const config::Scan& scan = config.scan(0);
  const std::string preset =
      scan.preset() == "auto" ? survey.Find(scan.channel())->preset : scan.preset();
  const SensorOptions options = SensorOptionsOf(scan, preset);
  RecordingSample sample;
  const absl::Status read = ReadLcmLog(
      log,
      [&](const LogEvent& event) {
        if (event.channel == config.pose()) {
          if (const auto pose = DecodePose(event.message); pose.ok()) sample.poses.Add(*pose);
        } else if (event.channel == scan.channel()) {
          auto readings = DecodeScan(event.message);
          if (!readings.ok()) return;
          if (options.stamp_is_receipt) *readings = At(*std::move(readings), event.utime);
          sample.scans.push_back(*std::move(readings));
        }
      },
      [](double) {});
  return SpreadOf(sample, options);
}

// Of a recorded drive: no sharper without flags, whatever the pose channel. Refusing is right where
// flags would be needed.
absl::StatusOr<Verdict> JudgeRecorded(const std::string& name, const std::string& log) {
  SPLINEMAP_ASSIGN_OR_RETURN(const Survey survey, SurveyOf(log));
  Verdict verdict{.drive = name};
  const absl::StatusOr<config::Config> config = Ask(survey);
  SampleSpread proposed;
  if (config.ok()) {
    verdict.flags = Describe(*config);
    proposed = SpreadOfAll(log, survey, *config);
    verdict.figures = fmt::format("{:.0f} cells, {} hits;", proposed.cells, proposed.hits);
  } else {
    verdict.flags = ErrorText(config.status());
  }
  for (const std::string& scan : ChannelsOf(survey, &IsScan)) {
    if (config.ok() && scan != config->scan(0).channel()) continue;
    for (const std::string& pose : ChannelsOf(survey, &IsPose)) {
      const SampleSpread given = SpreadOfAll(log, survey, WithoutFlags(scan, pose));
      verdict.figures +=
          fmt::format(" {:.0f}, {} without flags on {};", given.cells, given.hits, pose);
      if (!config.ok() && given.hits > 0) verdict.wrong = "it is refused";
      // Fewer hits lie in fewer cells, whatever the flags.
      const bool is_comparable = given.hits * 50 > proposed.hits * 49;
      verdict.is_worse |=
          config.ok() && is_comparable && proposed.cells > kSharpnessWorse * given.cells;
    }
  }
  if (verdict.is_worse) verdict.wrong = "it is sharper without flags";
  return verdict;
}

absl::StatusOr<std::vector<Verdict>> JudgeFolder(const std::string& folder,
                                                 const std::string& log) {
  std::vector<std::filesystem::path> paths;
  for (const auto& entry : std::filesystem::recursive_directory_iterator(folder)) {
    if (entry.is_regular_file()) paths.push_back(entry.path());
  }
  std::sort(paths.begin(), paths.end());
  std::vector<Verdict> verdicts;
  for (const std::filesystem::path& path : paths) {
    const std::string name = path.filename();
    const bool is_carmen = name.ends_with(".log.gz") || name.ends_with(".log");
    const bool is_lcm = name.ends_with(".lcmlog") || name.ends_with(".lcmlog.gz");
    if (!is_carmen && !is_lcm) continue;
    if (is_carmen) SPLINEMAP_RETURN_IF_ERROR(ImportCarmen(path, log));
    SPLINEMAP_ASSIGN_OR_RETURN(Verdict verdict,
                               JudgeRecorded(name, is_carmen ? log : path.string()));
    verdicts.push_back(std::move(verdict));
  }
  return verdicts;
}

void Print(const Verdict& verdict) {
  fmt::print("{:<60} {}  {}{}{}\n", verdict.drive, verdict.figures, verdict.flags,
             verdict.wrong.empty() ? "" : "  WRONG: ", verdict.wrong);
  std::fflush(stdout);
}

absl::StatusOr<int> Run(const Flags& flags) {
  const TemporaryDirectory directory;
  const std::string log = directory.File("drive.lcmlog");
  bool holds = true;
  if (!flags.folder.empty()) {
    SPLINEMAP_ASSIGN_OR_RETURN(const std::vector<Verdict> recorded, JudgeFolder(flags.folder, log));
    for (const Verdict& verdict : recorded) {
      holds &= verdict.wrong.empty();
      if (flags.table || !verdict.wrong.empty()) Print(verdict);
    }
    fmt::print("{} recorded drives\n", recorded.size());
    if (recorded.empty()) return InvalidArgument("{} has no log", flags.folder);
  }
  if (flags.table) {
    fmt::print("off and found in %: without the fault | with it, no flags | proposed flags\n");
  }
  int drives = 0;
  int right = 0;
  int worse = 0;
  for (int k = 0; k < flags.drives; ++k) {
    if (flags.only >= 0 && k != flags.only) continue;
    SPLINEMAP_ASSIGN_OR_RETURN(const Verdict verdict, Judge(k, flags, log));
    ++drives;
    right += verdict.wrong.empty();
    worse += verdict.is_worse;
    if (flags.table || !verdict.wrong.empty()) Print(verdict);
  }
  fmt::print("{} simulated drives: {} right, {} worse than without flags\n", drives, right, worse);
  return holds && worse == 0 && right >= kMostlyRight * drives ? 0 : 1;
}

int Main(int argc, char** argv) {
  Flags flags;
  CLI::App app("What splinemap doctor proposes never makes a worse map, and is mostly right.");
  app.add_option("FOLDER", flags.folder, "Recorded drives, LCM and CARMEN logs, also in folders");
  app.add_option("--drives", flags.drives, "Simulated drives (default 200)");
  app.add_option("--seed", flags.seed, "Of the drives (default 1)");
  app.add_option("--only", flags.only, "The number of one drive");
  app.add_flag("--table", flags.table, "A line for every drive, not for wrong ones alone");
  CLI11_PARSE(app, argc, argv);
  const absl::StatusOr<int> status = Run(flags);
  if (!status.ok()) fmt::print(stderr, "{}\n", ErrorText(status.status()));
  return status.value_or(1);
}

}  // namespace
}  // namespace splinemap::doctor_law

int main(int argc, char** argv) { return splinemap::doctor_law::Main(argc, argv); }
