#include "lib/pipeline/log_survey.h"

#include <map>

#include "lib/base/status.h"
#include "lib/logs/lcm_log.h"

namespace splinemap {
namespace {

struct Sighting {
  LoggedChannel channel;
  Utime first{0};
  Utime last{0};
};

// In floating point, since the times of a damaged log may be anything.
double Seconds(Utime utime) { return static_cast<double>(utime.count()) * 1e-6; }

Sighting FirstSight(const LogEvent& event) {
  Sighting sighting;
  sighting.first = event.utime;
  sighting.channel.name = event.channel;
  sighting.channel.fingerprint = FingerprintOf(event.message);
  sighting.channel.type = TypeOf(event.message);
  if (sighting.channel.type && IsScan(*sighting.channel.type)) {
    if (const auto readings = DecodeScan(event.message); readings.ok()) {
      sighting.channel.preset =
          DetectPreset(sighting.channel.type == MessageType::kPlanarLidar, *readings).value_or("");
    }
  }
  return sighting;
}

// The only channel of the kind, or an error that names the flag to choose with.
absl::StatusOr<std::string> OnlyChannel(const LogSurvey& survey, bool (*is_kind)(MessageType),
                                        const char* kind, const char* flag) {
  std::vector<const LoggedChannel*> fitting;
  for (const LoggedChannel& channel : survey.channels) {
    if (channel.type && is_kind(*channel.type)) fitting.push_back(&channel);
  }
  if (fitting.empty()) {
    return InvalidArgument("the log has no channel of {}", kind);
  }
  if (fitting.size() == 1) return fitting.front()->name;
  std::string text =
      fmt::format("several channels of the log carry {}; choose with {}:", kind, flag);
  for (const LoggedChannel* channel : fitting) {
    text += fmt::format("\n  {} {:<20} {:>7.1f} Hz, {} messages of {}", flag, channel->name,
                        channel->rate_hz, channel->messages, TypeName(*channel->type));
  }
  return absl::InvalidArgumentError(text);
}

absl::Status CheckChannel(const LogSurvey& survey, const std::string& name,
                          bool (*is_kind)(MessageType), const char* kind) {
  std::vector<std::string> names;
  for (const LoggedChannel& channel : survey.channels) {
    const bool fits = channel.type && is_kind(*channel.type);
    if (channel.name == name && fits) return absl::OkStatus();
    if (fits) names.push_back(channel.name);
  }
  return InvalidArgument("{} is no channel of {} in the log; there are: {}", name, kind,
                         names.empty() ? "none" : fmt::format("{}", fmt::join(names, ", ")));
}

}  // namespace

absl::StatusOr<LogSurvey> SurveyLog(const std::string& path,
                                    absl::FunctionRef<void(double)> progress) {
  std::map<std::string, Sighting> sightings;
  std::optional<Utime> first;
  Utime last{0};
  const absl::Status status = ReadLcmLog(
      path,
      [&](const LogEvent& event) {
        if (!first) first = event.utime;
        last = event.utime;
        auto place = sightings.find(event.channel);
        if (place == sightings.end()) {
          place = sightings.emplace(event.channel, FirstSight(event)).first;
        }
        ++place->second.channel.messages;
        place->second.last = event.utime;
      },
      progress);
  if (!status.ok() && sightings.empty()) return status;
  LogSurvey survey;
  survey.damage = ErrorText(status);
  if (first) survey.duration_s = Seconds(last) - Seconds(*first);
  for (auto& [name, sighting] : sightings) {
    const double span_s = Seconds(sighting.last) - Seconds(sighting.first);
    LoggedChannel& channel = sighting.channel;
    if (span_s > 0) channel.rate_hz = static_cast<double>(channel.messages - 1) / span_s;
    survey.channels.push_back(std::move(channel));
  }
  return survey;
}

absl::Status ChooseChannels(const LogSurvey& survey, config::Config& config) {
  for (const config::Scan& scan : config.scan()) {
    SPLINEMAP_RETURN_IF_ERROR(CheckChannel(survey, scan.channel(), &IsScan, "scans"));
  }
  if (!config.pose().empty()) {
    SPLINEMAP_RETURN_IF_ERROR(CheckChannel(survey, config.pose(), &IsPose, "poses"));
  }
  if (config.scan_size() == 0) {
    SPLINEMAP_ASSIGN_OR_RETURN(const std::string channel,
                               OnlyChannel(survey, &IsScan, "scans", "--scan"));
    config.add_scan()->set_channel(channel);
  }
  if (config.pose().empty()) {
    SPLINEMAP_ASSIGN_OR_RETURN(const std::string channel,
                               OnlyChannel(survey, &IsPose, "poses", "--pose"));
    config.set_pose(channel);
  }
  return absl::OkStatus();
}

}  // namespace splinemap
