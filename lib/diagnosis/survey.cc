#include "lib/diagnosis/survey.h"

#include <algorithm>

#include "lcmtypes/splinemap/status_t.hpp"
#include "lib/base/did_you_mean.h"
#include "lib/base/plain_text.h"
#include "lib/base/status.h"
#include "lib/diagnosis/recording_sample.h"
#include "lib/logs/lcm_log.h"
#include "lib/wire/decode.h"
#include "lib/wire/sensor_messages.h"

namespace splinemap {
namespace {

// Of fewer messages, or in less time, a rate is chance.
constexpr double kLeastSpan_s = 0.1;

// In floating point, since the times of a damaged log may be anything.
double Seconds(Utime utime) { return static_cast<double>(utime.count()) * 1e-6; }

double Median(std::vector<double> values) {
  if (values.empty()) return 0;
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

// The only channel of the kind, or an error that names the flag to choose with.
absl::StatusOr<std::string> OnlyChannel(const Survey& survey, bool (*is_kind)(MessageType),
                                        const char* kind, const char* flag) {
  std::vector<SurveyedChannel> fitting;
  for (const SurveyedChannel& channel : survey.channels()) {
    if (channel.type && is_kind(*channel.type)) fitting.push_back(channel);
  }
  if (fitting.empty()) return InvalidArgument("there is no channel of {}", kind);
  if (fitting.size() == 1) return fitting.front().name;
  std::string text = fmt::format(
      "several channels carry {}; choose with {} (splinemap doctor tells which is sharpest):", kind,
      flag);
  for (const SurveyedChannel& channel : fitting) {
    text +=
        fmt::format("\n  {} {:<20} {:>7.1f} Hz, {} messages of {}", flag, PlainText(channel.name),
                    channel.rate_hz, channel.messages, TypeName(*channel.type));
  }
  return absl::InvalidArgumentError(text);
}

absl::Status CheckChannel(const Survey& survey, const std::string& name,
                          bool (*is_kind)(MessageType), const char* kind) {
  std::vector<std::string> names;
  for (const SurveyedChannel& channel : survey.channels()) {
    const bool fits = channel.type && is_kind(*channel.type);
    if (channel.name == name && fits) return absl::OkStatus();
    if (fits) names.push_back(PlainText(channel.name));
  }
  return InvalidArgument("{} is no channel of {}{}; there are: {}", name, kind,
                         DidYouMean(name, names),
                         names.empty() ? "none" : fmt::format("{}", fmt::join(names, ", ")));
}

// What the daemon reads, and what it says of itself.
bool IsSurveyed(MessageType type) {
  return IsScan(type) || IsPose(type) || type == MessageType::kRigidTransform ||
         type == MessageType::kStatus;
}

}  // namespace

Survey::Sighting* Survey::Count(Utime received, const std::string& name,
                                absl::Span<const uint8_t> message) {
  if (!first_received_) first_received_ = received;
  last_received_ = received;
  auto place = sightings_.find(name);
  if (place == sightings_.end()) {
    if (sightings_.size() >= kMaxChannels) return nullptr;
    place = sightings_.try_emplace(name).first;
    place->second.channel.name = name;
    place->second.channel.fingerprint = FingerprintOf(message);
    place->second.first_received = received;
  }
  Sighting& sighting = place->second;
  ++sighting.channel.messages;
  sighting.last_received = received;
  if (!sighting.channel.type) SetType(sighting, message);
  return &sighting;
}

void Survey::Add(Utime received, const std::string& name, absl::Span<const uint8_t> message) {
  Sighting* const added = Count(received, name, message);
  if (added == nullptr || !added->channel.type) return;
  Sighting& sighting = *added;
  SurveyedChannel& channel = sighting.channel;
  const absl::StatusOr<Utime> utime = Check(sighting, message, received);
  if (!utime.ok()) {
    if (channel.malformed++ == 0) channel.complaint = ErrorText(utime.status());
    return;
  }
  if (sighting.lags_s.size() < kMaxLags) {
    sighting.lags_s.push_back(Seconds(received) - Seconds(*utime));
  }
  if (sighting.last_utime) {
    channel.repeated += *utime == *sighting.last_utime;
    channel.stepped_back += *utime < *sighting.last_utime;
    channel.longest_gap_s =
        std::max(channel.longest_gap_s, Seconds(*utime) - Seconds(*sighting.last_utime));
  }
  sighting.last_utime = *utime;
  if (!sighting.first_utime) sighting.first_utime = *utime;
}

// By how they count on while messages come.
std::string Survey::OddStamps(const Sighting& sighting) {
  const SurveyedChannel& channel = sighting.channel;
  constexpr int64_t kFewMessages = 10;
  const double received_s = Seconds(sighting.last_received) - Seconds(sighting.first_received);
  if (channel.messages < kFewMessages || received_s < 1 || !sighting.first_utime) return "";
  const double stamped_s = Seconds(*sighting.last_utime) - Seconds(*sighting.first_utime);
  const double rate = stamped_s / received_s;
  const auto is_near = [&](double unit) { return rate > unit / 2 && rate < unit * 2; };
  if (is_near(1e-3)) return "its time stamps seem to be milliseconds; messages have microseconds";
  if (is_near(1e-6)) return "its time stamps seem to be seconds; messages have microseconds";
  if (channel.repeated * 10 >= channel.messages * 9) {
    return fmt::format("its time stamps do not count: {} of {} are {} us", channel.repeated + 1,
                       channel.messages, sighting.last_utime->count());
  }
  return "";
}

void Survey::SetType(Sighting& sighting, absl::Span<const uint8_t> message) {
  SurveyedChannel& channel = sighting.channel;
  const auto type = TypeOf(message);
  if (!type || !IsSurveyed(*type)) return;  // it has a name at most
  channel.type = type;
  if (channel.messages > 1) {
    channel.malformed = channel.messages - 1;
    channel.complaint = "it begins with messages of another type";
  }
  channel.fingerprint = FingerprintOf(message);
  sighting.is_sampled = (IsScan(*channel.type) && scan_channels_++ < kMaxScanChannels) ||
                        (IsPose(*channel.type) && pose_channels_++ < kMaxPoseChannels);
}

absl::StatusOr<Utime> Survey::Check(Sighting& sighting, absl::Span<const uint8_t> message,
                                    Utime received) {
  SurveyedChannel& channel = sighting.channel;
  if (TypeOf(message) != channel.type) return InvalidArgument("{}", Describe(message));
  if (IsPose(*channel.type)) {
    SPLINEMAP_ASSIGN_OR_RETURN(const TimedPose pose, DecodePose(message));
    if (sighting.is_sampled && channel.messages <= static_cast<int64_t>(kMaxPoses)) {
      sighting.poses.Add(pose);
    }
    return pose.utime;
  }
  if (IsScan(*channel.type)) {
    SPLINEMAP_ASSIGN_OR_RETURN(RangeReadings readings, DecodeScan(message));
    const Utime utime = readings.utime;
    if (channel.preset.empty()) {
      const bool is_planar_lidar = channel.type == MessageType::kPlanarLidar;
      channel.preset = DetectPreset(is_planar_lidar, readings).value_or("");
      channel.useless_beam_times = !is_planar_lidar && !HaveUsefulBeamTimes(readings);
    }
    sighting.readings.Add(readings);
    if (sighting.is_sampled && sighting.scans.size() < kMaxScans) {
      sighting.scans.push_back(Thinned(std::move(readings), kMaxBeams));
      sighting.scans_received.push_back(received);
    }
    return utime;
  }
  if (channel.type == MessageType::kStatus) {
    SPLINEMAP_ASSIGN_OR_RETURN(const status_t status, Decode<status_t>(message));
    return Utime(status.utime);
  }
  SPLINEMAP_ASSIGN_OR_RETURN(const SensorMount mount, DecodeSensorMount(message));
  if (!sighting.mount) sighting.mount = mount;
  return UtimeOf(message);
}

std::vector<SurveyedChannel> Survey::channels() const {
  std::vector<SurveyedChannel> channels;
  for (const auto& [name, sighting] : sightings_) {
    SurveyedChannel& channel = channels.emplace_back(sighting.channel);
    const double span_s = Seconds(sighting.last_received) - Seconds(sighting.first_received);
    if (channel.messages > 2 && span_s > kLeastSpan_s)
      channel.rate_hz = static_cast<double>(channel.messages - 1) / span_s;
    channel.lag_s = Median(sighting.lags_s);
    channel.odd_stamps = OddStamps(sighting);
  }
  return channels;
}

std::optional<SurveyedChannel> Survey::Find(const std::string& name) const {
  for (SurveyedChannel& channel : channels()) {
    if (channel.name == name) return std::move(channel);
  }
  return std::nullopt;
}

double Survey::duration_s() const {
  return first_received_ ? Seconds(last_received_) - Seconds(*first_received_) : 0;
}

const std::vector<RangeReadings>& Survey::ScansOf(const std::string& channel) const {
  static const auto* const none = new std::vector<RangeReadings>();
  const auto place = sightings_.find(channel);
  return place == sightings_.end() ? *none : place->second.scans;
}

std::vector<RangeReadings> Survey::ScansAsReceived(const std::string& channel) const {
  std::vector<RangeReadings> scans = ScansOf(channel);
  for (size_t k = 0; k < scans.size(); ++k) {
    scans[k] = At(std::move(scans[k]), sightings_.at(channel).scans_received[k]);
  }
  return scans;
}

const ReadingStatistics& Survey::ReadingsOf(const std::string& channel) const {
  static const auto* const none = new ReadingStatistics();
  const auto place = sightings_.find(channel);
  return place == sightings_.end() ? *none : place->second.readings;
}

const PoseBuffer& Survey::PosesOf(const std::string& channel) const {
  static const auto* const none = new PoseBuffer(Utime(0));
  const auto place = sightings_.find(channel);
  return place == sightings_.end() ? *none : place->second.poses;
}

std::optional<SensorMount> Survey::MountOf(const std::string& channel) const {
  const auto place = sightings_.find(channel);
  return place == sightings_.end() ? std::nullopt : place->second.mount;
}

absl::StatusOr<Survey> SurveyLog(const std::string& path, SurveyDepth depth,
                                 absl::FunctionRef<void(double)> progress, std::string& damage) {
  Survey survey;
  const absl::Status status = ReadLcmLog(
      path,
      [&](const LogEvent& event) {
        if (depth == SurveyDepth::kTypes) {
          survey.AddType(event.utime, event.channel, event.message);
        } else {
          survey.Add(event.utime, event.channel, event.message);
        }
      },
      progress);
  damage = ErrorText(status);
  if (!status.ok() && survey.channels().empty()) return status;
  return survey;
}

absl::Status ChooseChannels(const Survey& survey, config::Config& config) {
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
