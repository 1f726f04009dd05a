#include <CLI/App.hpp>
#include <cstdio>
#include <memory>
#include <nlohmann/json.hpp>

#include "absl/strings/str_replace.h"
#include "clients/splinemap/bus_flags.h"
#include "clients/splinemap/commands.h"
#include "clients/splinemap/print.h"
#include "clients/splinemap/progress.h"
#include "lib/base/clock.h"
#include "lib/base/status.h"
#include "lib/config/flags.h"
#include "lib/diagnosis/proposal.h"
#include "lib/diagnosis/survey.h"
#include "lib/wire/lcm_bus.h"
#include "lib/wire/message_type.h"

namespace splinemap {
namespace {

struct DoctorFlags {
  std::string log;
  bool live = false;
  double seconds = 15;
  std::string lcm_url;
  bool json = false;
  InputFlags input;
};

std::string TypeOf(const SurveyedChannel& channel) {
  if (!channel.fingerprint) return "no LCM type";
  const std::string name = FingerprintName(*channel.fingerprint);
  return name.empty() ? fmt::format("{:#018x}", *channel.fingerprint) : name;
}

// The flags to add to those that are given.
std::vector<std::string> FlagsOf(const FlagChoice& choice, const config::Config& given) {
  std::vector<std::string> flags;
  if (given.scan_size() == 0) {
    for (const std::string& flag : choice.scan_flags) {
      flags.insert(flags.end(), {"--scan", flag});
    }
  }
  if (given.pose().empty()) flags.insert(flags.end(), {"--pose", choice.pose});
  return flags;
}

nlohmann::json ToJson(const FlagTrial& trial) {
  nlohmann::json json = {
      {"scan", trial.scan},
      {"pose", trial.pose},
      {"clock_offset_s", std::chrono::duration<double>(trial.clock_offset).count()},
      {"scans_compared", trial.scans}};
  if (trial.flags) {
    if (trial.spread_as_given) json["cells_as_given"] = *trial.spread_as_given;
    json["cells_proposed"] = trial.flags->spread;
    json["cells_flipped"] = trial.flags->spread_flipped;
  }
  return json;
}

nlohmann::json ToJson(const SurveyedChannel& channel) {
  nlohmann::json json = {{"name", channel.name},
                         {"type", TypeOf(channel)},
                         {"messages", channel.messages},
                         {"rate_hz", channel.rate_hz}};
  if (!channel.preset.empty()) json["preset"] = channel.preset;
  if (channel.type) {
    json["malformed"] = channel.malformed;
    json["repeated"] = channel.repeated;
    json["stepped_back"] = channel.stepped_back;
    json["longest_gap_s"] = channel.longest_gap_s;
    json["lag_s"] = channel.lag_s;
  }
  return json;
}

nlohmann::json ToJson(const Survey& survey, const absl::StatusOr<Proposal>& proposal,
                      const config::Config& given) {
  nlohmann::json json;
  json["duration_s"] = survey.duration_s();
  json["channels"] = nlohmann::json::array();
  for (const SurveyedChannel& channel : survey.channels()) {
    json["channels"].push_back(ToJson(channel));
  }
  json["remarks"] = Remarks(survey);
  if (proposal.ok()) {
    json["pose"] = proposal->pose;
    json["scans"] = proposal->scans;
    json["scan_flags"] = proposal->scan_flags;
    json["chosen_flags"] = FlagsOf({proposal->pose, proposal->scan_flags}, given);
    if (proposal->close_second) json["close_second"] = FlagsOf(*proposal->close_second, given);
    json["cautions"] = proposal->cautions;
    if (!proposal->problem.empty()) json["problem"] = proposal->problem;
    json["trials"] = nlohmann::json::array();
    for (const FlagTrial& trial : proposal->trials) json["trials"].push_back(ToJson(trial));
  } else {
    json["problem"] = ErrorText(proposal.status());
  }
  return json;
}

void PrintChannels(const Survey& survey) {
  PrintLine(stdout, "{:<24} {:<26} {:>9} {:>9}  {}", "channel", "type", "messages", "rate_hz",
            "preset");
  for (const SurveyedChannel& channel : survey.channels()) {
    PrintLine(stdout, "{:<24} {:<26} {:>9} {:>9.1f}  {}", PlainText(channel.name), TypeOf(channel),
              channel.messages, channel.rate_hz, channel.preset);
  }
  PrintLine(stdout, "{:.1f} s", survey.duration_s());
  for (const std::string& remark : Remarks(survey)) {
    PrintLine(stdout, "{}", remark);
  }
}

void PrintTrials(const Proposal& proposal) {
  fmt::print("\nCells of 5 cm with hits, from the same scans; fewer is sharper:\n");
  PrintLine(stdout, "{:<20} {:<20} {:>6} {:>9} {:>9} {:>11}", "scan", "pose", "scans", "as given",
            "proposed", "other sign");
  for (const FlagTrial& trial : proposal.trials) {
    const std::string compared = fmt::format("{:<20} {:<20} {:>6} ", PlainText(trial.scan),
                                             PlainText(trial.pose), trial.scans);
    if (trial.flags) {
      const std::string as_given =
          trial.spread_as_given ? fmt::format("{:.0f}", *trial.spread_as_given) : "-";
      PrintLine(stdout, "{}{:>9} {:>9.0f} {:>11.0f}{}", compared, as_given, trial.flags->spread,
                trial.flags->spread_flipped,
                trial.flags->is_time_beyond ? "  clocks may be more than 1 s apart" : "");
    } else {
      PrintLine(stdout, "{}not compared; the robot turned too little or has too few poses",
                compared);
    }
  }
}

// The word as a shell takes it, since a channel may have any name.
std::string Quoted(const std::string& word) {
  constexpr const char* kPlain =
      "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789_-.,:=/+";
  if (word.find_first_not_of(kPlain) == std::string::npos) return word;
  return "'" + absl::StrReplaceAll(PlainText(word), {{"'", "'\\''"}}) + "'";
}

void PrintChoice(const char* what, const FlagChoice& choice) {
  std::string flags;
  for (const std::string& flag : choice.scan_flags) flags += " --scan " + Quoted(flag);
  PrintLine(stdout, "{}:{} --pose {}", what, flags, Quoted(choice.pose));
}

void PrintFlags(const Proposal& proposal) {
  PrintLine(stdout, "");
  PrintChoice(proposal.problem.empty() ? "map it with" : "continue the search with",
              {proposal.pose, proposal.scan_flags});
  if (proposal.close_second) PrintChoice("or compare", *proposal.close_second);
  for (const std::string& channel : proposal.scans) {
    if (channel.find_first_of(":,") == std::string::npos) continue;
    PrintLine(stdout,
              "{} contains a colon or comma; --scan cannot take it. Name it in a file for --config",
              channel);
  }
}

absl::StatusOr<Survey> Listen(const DoctorFlags& flags) {
  SPLINEMAP_ASSIGN_OR_RETURN(std::unique_ptr<LcmBus> bus, LcmBus::Open(flags.lcm_url));
  Survey survey;
  bus->SubscribeToAll([&](const std::string& channel, absl::Span<const uint8_t> message) {
    const auto now = std::chrono::system_clock::now().time_since_epoch();
    survey.Add(std::chrono::duration_cast<Utime>(now), channel, message);
  });
  const auto begin = Clock::now();
  ProgressBar bar("listening");
  while (true) {
    const double passed_s = std::chrono::duration<double>(Clock::now() - begin).count();
    if (passed_s >= flags.seconds) break;
    bar.Show(passed_s / flags.seconds);
    bus->Handle(std::chrono::milliseconds(100));
  }
  if (survey.channels().empty() && !bus->Problem().empty()) {
    return Unavailable("{}", bus->Problem());
  }
  if (survey.channels().empty()) {
    return Unavailable("nothing was received on the bus in {:g} s; is the LCM URL right?",
                       flags.seconds);
  }
  return survey;
}

// Checks the options of scan channels; what is not given is chosen later.
absl::Status CheckGiven(config::Config given) {
  if (given.scan_size() == 0) return absl::OkStatus();
  if (given.pose().empty()) given.set_pose("POSE");
  return CheckConfig(given);
}

absl::StatusOr<int> Doctor(const DoctorFlags& flags) {
  SPLINEMAP_ASSIGN_OR_RETURN(const config::Config given, ConfigOf(flags.input));
  SPLINEMAP_RETURN_IF_ERROR(CheckGiven(given));
  if (flags.live != flags.log.empty()) {
    return InvalidArgument("give an LCM log, or --live in its place");
  }
  Survey survey;
  std::string damage;
  if (flags.live) {
    SPLINEMAP_ASSIGN_OR_RETURN(survey, Listen(flags));
  } else {
    ProgressBar bar("reading");
    const auto show = [&](double share) { bar.Show(share); };
    SPLINEMAP_ASSIGN_OR_RETURN(survey, SurveyLog(flags.log, SurveyDepth::kAll, show, damage));
  }
  if (!damage.empty()) PrintLine(stderr, "{}", damage);
  const absl::StatusOr<Proposal> proposal = Propose(survey, given);
  if (flags.json) {
    PrintJson(ToJson(survey, proposal, given));
    return damage.empty() && proposal.ok() && proposal->problem.empty() ? kSuccess : kFailed;
  }
  PrintChannels(survey);
  if (!proposal.ok()) return Unavailable("{}", ErrorText(proposal.status()));
  PrintTrials(*proposal);
  for (const std::string& caution : proposal->cautions) {
    PrintLine(stdout, "{}", caution);
  }
  PrintFlags(*proposal);
  if (!proposal->problem.empty()) return Unavailable("{}", proposal->problem);
  return damage.empty() ? kSuccess : kFailed;
}

constexpr const char* kDoctorExamples = R"(
Examples:
  splinemap doctor drive.lcmlog
  splinemap doctor drive.lcmlog --json --pose SLAM_POSE
  splinemap doctor --live --seconds 20

Lists the channels and their irregularities, tries signs of bearing, mounts, time offsets and pose
channels on the first minutes, and proposes the flags for the sharpest map. The robot should drive
and turn meanwhile. Messages above 1 MB are ignored on a bus.

The table counts the cells of 5 cm that the hits of some scans lie in, weighed by their hits: the
fewer, the sharper the map. A row is a scan channel placed by a pose channel; rows of a scan channel
compare the same scans. "as given": with the flags given, or none; "-" where these place too few
hits. "proposed": with the best flags for this row. "other sign": with these and bearings turned the
other way, where a right map gets several times as many cells.)";

}  // namespace

void AddDoctor(CLI::App& app, Command& chosen) {
  auto flags = std::make_shared<DoctorFlags>();
  CLI::App* command =
      app.add_subcommand("doctor", "Inspect an LCM log or bus, and propose the flags to map it");
  command->footer(kDoctorExamples);
  command->add_option("LOG", flags->log, "LCM log, or --live in its place");
  CLI::Option* const live =
      command->add_flag("--live", flags->live, "Inspect the messages on an LCM bus");
  AddLcmUrlFlag(*command, flags->lcm_url, live);
  RequireLive(command->add_option("--seconds", flags->seconds, "s to listen (default 15)")
                  ->check(CLI::Range(0.1, 3600.0)),
              live);
  AddInputFlags(*command, flags->input);
  AddJsonFlag(*command, flags->json);
  command->callback([flags, &chosen] { chosen = [flags] { return Doctor(*flags); }; });
}

}  // namespace splinemap
