#include <cstdio>
#include <memory>
#include <nlohmann/json.hpp>

#include "absl/strings/escaping.h"
#include "clients/splinemap/commands.h"
#include "clients/splinemap/progress.h"
#include "lib/base/status.h"
#include "lib/config/flags.h"
#include "lib/pipeline/log_survey.h"

namespace splinemap {
namespace {

struct Flags {
  std::string log;
  bool json = false;
  InputFlags input;
};

std::string TypeOf(const LoggedChannel& channel) {
  if (channel.type) return TypeName(*channel.type);
  if (channel.fingerprint) return fmt::format("{:#018x}", *channel.fingerprint);
  return "no LCM type";
}

// The flags that have to be added to those of `given` for the channels of `chosen`.
std::vector<std::string> FlagsOf(const config::Config& chosen, const config::Config& given) {
  std::vector<std::string> flags;
  for (int k = given.scan_size(); k < chosen.scan_size(); ++k) {
    flags.insert(flags.end(), {"--scan", chosen.scan(k).channel()});
  }
  if (given.pose().empty()) flags.insert(flags.end(), {"--pose", chosen.pose()});
  return flags;
}

void PrintJson(const LogSurvey& survey, const config::Config& chosen, const config::Config& given,
               const absl::Status& choice) {
  nlohmann::json json;
  json["duration_s"] = survey.duration_s;
  json["channels"] = nlohmann::json::array();
  for (const LoggedChannel& channel : survey.channels) {
    nlohmann::json entry = {{"name", channel.name},
                            {"type", TypeOf(channel)},
                            {"messages", channel.messages},
                            {"rate_hz", channel.rate_hz}};
    if (!channel.preset.empty()) entry["preset"] = channel.preset;
    json["channels"].push_back(entry);
  }
  if (choice.ok()) {
    json["pose"] = chosen.pose();
    json["scans"] = nlohmann::json::array();
    for (const config::Scan& scan : chosen.scan()) json["scans"].push_back(scan.channel());
    json["chosen_flags"] = FlagsOf(chosen, given);
  } else {
    json["problem"] = ErrorText(choice);
  }
  // Channel names may be any bytes.
  const auto replace = nlohmann::json::error_handler_t::replace;
  std::printf("%s\n", json.dump(2, ' ', false, replace).c_str());
}

void PrintTable(const LogSurvey& survey) {
  std::printf("%-24s %-26s %9s %9s  %s\n", "channel", "type", "messages", "rate_hz", "preset");
  for (const LoggedChannel& channel : survey.channels) {
    std::printf("%-24s %-26s %9ld %9.1f  %s\n", absl::Utf8SafeCHexEscape(channel.name).c_str(),
                TypeOf(channel).c_str(), static_cast<long>(channel.messages), channel.rate_hz,
                channel.preset.c_str());
  }
  std::printf("%.1f s\n", survey.duration_s);
}

absl::StatusOr<int> Doctor(const Flags& flags) {
  SPLINEMAP_ASSIGN_OR_RETURN(const config::Config given, ConfigOf(flags.input));
  LogSurvey survey;
  {
    ProgressBar bar("reading");
    SPLINEMAP_ASSIGN_OR_RETURN(survey,
                               SurveyLog(flags.log, [&](double share) { bar.Show(share); }));
  }
  if (!survey.damage.empty()) fmt::print(stderr, "{}\n", survey.damage);
  config::Config chosen = given;
  const absl::Status choice = ChooseChannels(survey, chosen);
  if (flags.json) {
    PrintJson(survey, chosen, given, choice);
    return survey.damage.empty() ? kSuccess : kFailed;
  }
  PrintTable(survey);
  SPLINEMAP_RETURN_IF_ERROR(choice);
  fmt::print("map it with: {}\n", fmt::join(FlagsOf(chosen, {}), " "));
  return survey.damage.empty() ? kSuccess : kFailed;
}

constexpr const char* kExamples = R"(
Examples:
  splinemap doctor drive.lcmlog
  splinemap doctor drive.lcmlog --json --pose SLAM_POSE)";

}  // namespace

void AddDoctor(CLI::App& app, Command& chosen) {
  auto flags = std::make_shared<Flags>();
  CLI::App* command =
      app.add_subcommand("doctor", "List the channels of an LCM log and how to map it");
  command->footer(kExamples);
  command->add_option("LOG", flags->log, "LCM log")->required();
  command->add_flag("--json", flags->json, "Output for programs");
  AddInputFlags(*command, flags->input);
  command->callback([flags, &chosen] { chosen = [flags] { return Doctor(*flags); }; });
}

}  // namespace splinemap
