#include "lib/diagnosis/proposal.h"

#include <algorithm>
#include <cmath>
#include <numbers>

#include "lib/base/plain_text.h"
#include "lib/base/status.h"
#include "lib/diagnosis/pose_oddities.h"

namespace splinemap {
namespace {

// The search is on the first ones; what it finds has to hold for all.
constexpr size_t kSampleScans = 200;
constexpr size_t kAllScans = Survey::kMaxScans;
// Time stamps of one clock differ by less, on the way to the log: wireless links take their time.
constexpr double kOtherClock_s = 0.5;
// Further apart, one of them is nonsense; options take no such offset.
constexpr double kMaxClockOffset_s = 3e9;
constexpr double kLongGap_s = 1;
constexpr double kNonsenseGap_s = 1e7;
// Nothing is on its way for longer.
constexpr double kLongestWay_s = 10;

std::vector<std::string> ChannelsOf(const Survey& survey, bool (*is_kind)(MessageType)) {
  std::vector<std::string> names;
  for (const SurveyedChannel& channel : survey.channels()) {
    const bool is_sampled =
        !survey.ScansOf(channel.name).empty() || !survey.PosesOf(channel.name).empty();
    if (channel.type && is_kind(*channel.type) && is_sampled) names.push_back(channel.name);
  }
  return names;
}

// What to add to the stamps of `scan` to have the clock of `pose`, if it is another one: the scans
// or the poses may also be heard late.
Utime ClockOffset(const Survey& survey, const config::Scan& scan, const std::string& pose) {
  const double scan_lag_s = scan.stamp() == "receive" ? 0 : survey.Find(scan.channel())->lag_s;
  const double offset_s = scan_lag_s - survey.Find(pose)->lag_s;
  if (std::abs(offset_s) < kOtherClock_s || std::abs(offset_s) > kMaxClockOffset_s) return Utime(0);
  return std::chrono::milliseconds(std::llround(offset_s * 1000));
}

// `scan` with what its stamps and readings ask for.
config::Scan WithWhatItNeeds(const Survey& survey, const config::Scan& scan) {
  config::Scan mended = scan;
  const auto complaint = survey.ReadingsOf(scan.channel()).Complain(scan.range_max_m());
  if (complaint && complaint->right_range_max_m) {
    mended.set_range_max_m(*complaint->right_range_max_m);
  }
  if (!survey.Find(scan.channel())->odd_stamps.empty()) mended.set_stamp("receive");
  return mended;
}

bool IsOfUse(const Survey& survey, const std::string& pose) {
  return ArePossible(survey.PosesOf(pose)) && survey.Find(pose)->odd_stamps.empty();
}

std::string PresetOf(const Survey& survey, const config::Scan& scan) {
  if (scan.preset() != "auto") return scan.preset();
  const std::string told = survey.Find(scan.channel())->preset;
  return told.empty() ? "bot_core" : told;
}

// As the mapper reads the channel, with the transform that came on its extrinsics_channel.
SensorOptions OptionsOf(const Survey& survey, const config::Scan& scan) {
  SensorOptions options = SensorOptionsOf(scan, PresetOf(survey, scan));
  if (scan.has_extrinsics_channel()) {
    options.mount = survey.MountOf(scan.extrinsics_channel()).value_or(options.mount);
  }
  return options;
}

// The flags of one scan channel, tried with each pose channel.
class Trials {
 public:
  Trials(const Survey& survey, const config::Scan& told, const std::vector<std::string>& poses)
      : Trials(survey, told, WithWhatItNeeds(survey, told), poses) {}

  std::vector<FlagTrial> Run() {
    const std::vector<RecordingSample> first = SamplesOf(kSampleScans);
    const std::vector<RecordingSample> all = SamplesOf(kAllScans);
    for (size_t k = 0; k < trials_.size(); ++k) {
      SensorOptions options = given_;
      options.time_offset = TimeOffset(trials_[k]);
      trials_[k].scans = all[k].scans.size();
      trials_[k].flags = SearchFlags(first[k], options);
      if (!trials_[k].flags) continue;
      CompareOnAll(all[k], options, *trials_[k].flags);
      trials_[k].spread_as_given = SpreadAsGiven(all[k], options);
    }
    LeaveOneClock();
    return std::move(trials_);
  }

 private:
  Trials(const Survey& survey, const config::Scan& told, const config::Scan& scan,
         const std::vector<std::string>& poses)
      : survey_(survey),
        as_given_(OptionsOf(survey, told)),
        given_(OptionsOf(survey, scan)),
        scans_(given_.stamp_is_receipt ? survey.ScansAsReceived(scan.channel())
                                       : survey.ScansOf(scan.channel())) {
    for (const std::string& pose : poses) {
      // First as if it was one clock.
      Add(scan.channel(), pose, Utime(0));
      const Utime offset = ClockOffset(survey, scan, pose);
      if (offset != Utime(0)) Add(scan.channel(), pose, offset);
    }
  }

  // Of a pose channel that was tried with two clocks, the trial that is right. One clock needs no
  // explanation.
  void LeaveOneClock() {
    for (auto other = trials_.begin(); other != trials_.end();) {
      const bool is_other_clock = other->clock_offset != Utime(0);
      if (!is_other_clock) {
        ++other;
        continue;
      }
      const auto same = other - 1;
      const bool is_better =
          other->flags
              ? !same->flags || other->flags->spread < kClearlySharper * same->flags->spread
              : same->scans == 0 && other->scans > 0;
      other = trials_.erase(is_better ? same : other);
      if (is_better) ++other;
    }
  }

  std::optional<double> SpreadAsGiven(const RecordingSample& all,
                                      const SensorOptions& needed) const {
    // Stamps that say nothing find no poses.
    if (needed.stamp_is_receipt != as_given_.stamp_is_receipt) return std::nullopt;
    const SampleSpread spread = SpreadOf(all, as_given_);
    if (10 * spread.hits < 9 * SpreadOf(all, needed).hits) return std::nullopt;
    return spread.cells;
  }

  void Add(const std::string& scan, const std::string& pose, Utime clock_offset) {
    trials_.push_back({.scan = scan,
                       .pose = pose,
                       .clock_offset = clock_offset,
                       .scans = 0,
                       .flags = std::nullopt,
                       .spread_as_given = std::nullopt});
  }

  std::vector<RecordingSample> SamplesOf(size_t max_scans) const {
    std::vector<RecordingSample> samples;
    for (const FlagTrial& trial : trials_) {
      samples.push_back(
          SampleOf(scans_, survey_.PosesOf(trial.pose), TimeOffset(trial), max_scans));
    }
    CompareEqualScans(samples);
    return samples;
  }

  // What is sharper on some scans has to be sharper on all, or nothing is changed.
  static void CompareOnAll(const RecordingSample& all, const SensorOptions& given,
                           FlagProposal& flags) {
    flags.spread_given = SpreadOf(all, given).cells;
    flags.spread = SpreadOf(all, flags.options).cells;
    if (!flags.is_time_beyond && flags.spread >= kSharper * flags.spread_given) {
      flags.options = given;
      flags.spread = flags.spread_given;
    }
    SensorOptions flipped = flags.options;
    flipped.bearing_sign = -flipped.bearing_sign;
    flags.spread_flipped = SpreadOf(all, flipped).cells;
  }

  Utime TimeOffset(const FlagTrial& trial) const { return given_.time_offset + trial.clock_offset; }

  // Spreads can be compared between pose channels where all have the same scans: those of the
  // largest sample that have poses of every channel that has enough to offer. Where they are too
  // few, the largest stays alone.
  void CompareEqualScans(std::vector<RecordingSample>& samples) const {
    const auto largest = std::max_element(samples.begin(), samples.end(),
                                          [](const RecordingSample& a, const RecordingSample& b) {
                                            return a.scans.size() < b.scans.size();
                                          });
    std::vector<RangeReadings> scans = largest->scans;
    const double turned_rad = largest->turned_rad;
    // Poses of less than half of the drive are no choice.
    const size_t enough = std::max(kMinDriveScans, largest->scans.size() / 2);
    const auto is_usable = [&](const RecordingSample& s) { return s.scans.size() >= enough; };
    for (size_t k = 0; k < samples.size(); ++k) {
      if (!is_usable(samples[k])) continue;
      std::erase_if(scans, [&](const RangeReadings& readings) {
        return !HasPosesAround(samples[k].poses, readings.utime + TimeOffset(trials_[k]));
      });
    }
    for (RecordingSample& sample : samples) {
      const bool takes_part =
          scans.size() < kMinDriveScans ? &sample == &*largest : is_usable(sample);
      if (!takes_part) sample.scans.clear();
      if (!takes_part || scans.size() < kMinDriveScans) continue;
      sample.scans = scans;
      sample.turned_rad = turned_rad;
    }
  }

  const Survey& survey_;
  SensorOptions as_given_;
  SensorOptions given_;  // and what stamps and readings ask for
  std::vector<RangeReadings> scans_;
  std::vector<FlagTrial> trials_;
};

// The sharpest, or one that is nearly as sharp with nothing changed.
const FlagTrial* Sharpest(const std::vector<FlagTrial>& trials, const std::string& scan) {
  const FlagTrial* best = nullptr;
  const FlagTrial* as_given = nullptr;
  for (const FlagTrial& trial : trials) {
    if (trial.scan != scan || !trial.flags) continue;
    if (best == nullptr || trial.flags->spread < best->flags->spread) best = &trial;
    if (trial.clock_offset != Utime(0) || trial.flags->spread < trial.flags->spread_given) continue;
    if (as_given == nullptr || trial.flags->spread < as_given->flags->spread) as_given = &trial;
  }
  const bool will_do =
      as_given != nullptr && kSharper * as_given->flags->spread <= best->flags->spread;
  return will_do ? as_given : best;
}

std::string FlagFor(const Survey& survey, const config::Scan& scan, const FlagTrial* trial) {
  const std::string preset = PresetOf(survey, scan);
  SensorOptions options = OptionsOf(survey, scan);
  if (trial != nullptr) {
    options.time_offset += trial->clock_offset;
    if (trial->flags) options = trial->flags->options;
  }
  config::Scan proposed = ScanWith(scan, preset, options);
  config::Scan alone;
  alone.set_channel(scan.channel());
  alone.set_preset(survey.Find(scan.channel())->preset);
  // The channel is enough where the preset is told, and nothing beside it is needed.
  if (ScanFlagOf(proposed) == ScanFlagOf(alone)) proposed.clear_preset();
  return ScanFlagOf(proposed);
}

void CautionOnExtrinsics(const Survey& survey, const config::Scan& scan, const FlagTrial* trial,
                         std::vector<std::string>& cautions) {
  if (!scan.has_extrinsics_channel()) return;
  const std::optional<SensorMount> mount = survey.MountOf(scan.extrinsics_channel());
  if (!mount) {
    cautions.push_back(
        fmt::format("{}: no transform (bot_core.rigid_transform_t) came on {}; until one does, "
                    "scans are dropped",
                    scan.channel(), scan.extrinsics_channel()));
  } else if (trial != nullptr && trial->flags) {
    const Pose2& sharper = trial->flags->options.mount.robot_T_sensor;
    const double turned_rad = WrapAngle(sharper.yaw_rad - mount->robot_T_sensor.yaw_rad);
    const Eigen::Vector2d moved_m = sharper.position_m - mount->robot_T_sensor.position_m;
    if (std::abs(turned_rad) < 0.1 && moved_m.norm() < 0.05) return;
    cautions.push_back(
        fmt::format("{}: the map is sharper with the sensor turned by {:.0f} degrees and moved by "
                    "({:.2f}, {:.2f}) m from what the transform on {} says; correct it there",
                    scan.channel(), turned_rad * 180 / std::numbers::pi, moved_m.x(), moved_m.y(),
                    scan.extrinsics_channel()));
  }
}

// Another pose channel that does nearly as well as the one that is chosen, or that few scans tell
// apart from it; or null.
const FlagTrial* CloseSecond(const std::vector<FlagTrial>& trials, const FlagTrial& chosen) {
  constexpr size_t kFewScans = 30;
  const FlagTrial* second = nullptr;
  for (const FlagTrial& trial : trials) {
    if (trial.scan != chosen.scan || trial.pose == chosen.pose || !trial.flags) continue;
    if (second == nullptr || trial.flags->spread < second->flags->spread) second = &trial;
  }
  if (second == nullptr) return nullptr;
  const bool is_clear = chosen.flags->spread < kClearlySharper * second->flags->spread;
  return is_clear && chosen.scans >= kFewScans ? nullptr : second;
}

std::string CloseCall(const FlagTrial& chosen, const FlagTrial& second) {
  return fmt::format(
      "a close call: of {} scans, {} makes {:.0f} cells and {} {:.0f}; compare the maps of both, "
      "or take a longer drive",
      chosen.scans, chosen.pose, chosen.flags->spread, second.pose, second.flags->spread);
}

const FlagTrial* TrialOf(const std::vector<FlagTrial>& trials, const std::string& scan,
                         const std::string& pose) {
  const auto trial = std::find_if(trials.begin(), trials.end(), [&](const FlagTrial& other) {
    return other.scan == scan && other.pose == pose;
  });
  return trial == trials.end() ? nullptr : &*trial;
}

std::vector<std::string> ScanFlags(const Survey& survey, const config::Config& config,
                                   const std::vector<FlagTrial>& trials, const std::string& pose) {
  std::vector<std::string> flags;
  for (const config::Scan& scan : config.scan()) {
    flags.push_back(
        FlagFor(survey, WithWhatItNeeds(survey, scan), TrialOf(trials, scan.channel(), pose)));
  }
  return flags;
}

std::string ProblemOf(const FlagTrial& trial) {
  return fmt::format(
      "{}: its scans and the poses of {} seem to be more than a second apart: the map gets sharper "
      "up to the last time offset that was tried; search on from there",
      trial.scan, trial.pose);
}

void RemarkOnClocks(const Survey& survey, std::vector<std::string>& remarks) {
  const std::vector<std::string> scans = ChannelsOf(survey, &IsScan);
  if (scans.empty()) return;
  const std::string& reference = scans.front();
  for (const SurveyedChannel& channel : survey.channels()) {
    if (!channel.type || !(IsPose(*channel.type) || IsScan(*channel.type))) continue;
    const double ahead_s = survey.Find(reference)->lag_s - channel.lag_s;
    const bool is_told = !channel.odd_stamps.empty() || !survey.Find(reference)->odd_stamps.empty();
    if (std::abs(ahead_s) < kOtherClock_s || is_told) continue;
    remarks.push_back(fmt::format(
        "{}: its stamps are {:.1f} s {} those of {} that are received "
        "with them: {}",
        channel.name, std::abs(ahead_s), ahead_s > 0 ? "ahead of" : "behind", reference,
        std::abs(ahead_s) < kLongestWay_s ? "another clock, or a long way" : "another clock"));
  }
}

// Of a robot that stood still any poses do; else it is not told which are best.
absl::Status CheckStoodStill(const Survey& survey, const std::vector<std::string>& poses) {
  if (std::all_of(poses.begin(), poses.end(),
                  [&](const std::string& pose) { return StoodStill(survey.PosesOf(pose)); })) {
    return absl::OkStatus();
  }
  return InvalidArgument(
      "the robot drove and turned too little to tell which poses are best; listen longer, or "
      "choose:\n  --pose {}",
      PlainLines(fmt::format("{}", fmt::join(poses, "\n  --pose "))));
}

// Those of `poses` that can be, at least one.
absl::StatusOr<std::vector<std::string>> PosesOfUse(const Survey& survey,
                                                    const std::vector<std::string>& poses) {
  std::vector<std::string> of_use = poses;
  std::erase_if(of_use, [&](const std::string& pose) { return !IsOfUse(survey, pose); });
  if (!of_use.empty()) return of_use;
  const std::string& pose = poses.front();
  const std::string stamps = survey.Find(pose)->odd_stamps;
  return InvalidArgument("nothing can be proposed: {}: {}", pose,
                         stamps.empty() ? PoseComplaint(survey.PosesOf(pose)) : stamps);
}

// Those of use of the channels that can be chosen from; scan channels are filled in.
absl::StatusOr<std::vector<std::string>> ChannelsToTry(const Survey& survey,
                                                       config::Config& config) {
  if (config.scan_size() == 0) {
    for (const std::string& name : ChannelsOf(survey, &IsScan)) {
      config.add_scan()->set_channel(name);
    }
  }
  std::vector<std::string> poses{config.pose()};
  if (config.pose().empty()) poses = ChannelsOf(survey, &IsPose);
  if (config.scan_size() == 0 || poses.empty()) {
    return InvalidArgument(
        "there is no channel of {}; splinemap reads bot_core.planar_lidar_t and Michigan's lidar_t "
        "for scans, bot_core.pose_t and Michigan's pose_xyt_t for poses, whatever their names",
        config.scan_size() == 0 ? "scans" : "poses");
  }
  config::Config first_choice = config;
  first_choice.set_pose(poses.front());
  SPLINEMAP_RETURN_IF_ERROR(ChooseChannels(survey, first_choice));
  SPLINEMAP_ASSIGN_OR_RETURN(poses, PosesOfUse(survey, poses));
  for (const config::Scan& scan : config.scan()) {
    const auto complaint = survey.ReadingsOf(scan.channel()).Complain(scan.range_max_m());
    if (complaint && !complaint->right_range_max_m) {
      return InvalidArgument("nothing can be proposed: {}: {}", scan.channel(), complaint->text);
    }
  }
  return poses;
}

// The channel of the most scans has most to say about poses.
const std::string& BusiestOf(const Survey& survey, const config::Config& config) {
  return std::max_element(config.scan().begin(), config.scan().end(),
                          [&](const auto& a, const auto& b) {
                            return survey.Find(a.channel())->messages <
                                   survey.Find(b.channel())->messages;
                          })
      ->channel();
}

}  // namespace

// Scans that the poses of another channel place far better are of another robot.
absl::Status CheckOneRobot(const Proposal& proposal) {
  constexpr double kOtherRobot = 2;  // times as many cells
  for (const FlagTrial& chosen : proposal.trials) {
    if (chosen.pose != proposal.pose || !chosen.flags) continue;
    for (const FlagTrial& other : proposal.trials) {
      if (other.scan != chosen.scan || !other.flags) continue;
      if (chosen.flags->spread < kOtherRobot * other.flags->spread) continue;
      return InvalidArgument(
          "these are two robots: the hits of {} lie in {:.0f} cells with the poses of {}, and in "
          "{:.0f} with those of {}. Give the channels of one robot with --scan and --pose",
          chosen.scan, chosen.flags->spread, chosen.pose, other.flags->spread, other.pose);
    }
  }
  return absl::OkStatus();
}

absl::StatusOr<Proposal> Propose(const Survey& survey, const config::Config& given) {
  config::Config config = given;
  SPLINEMAP_ASSIGN_OR_RETURN(const std::vector<std::string> poses, ChannelsToTry(survey, config));
  Proposal proposal;
  for (const config::Scan& scan : config.scan()) {
    proposal.scans.push_back(scan.channel());
    for (FlagTrial& trial : Trials(survey, scan, poses).Run()) {
      proposal.trials.push_back(std::move(trial));
    }
  }
  const FlagTrial* sharpest = Sharpest(proposal.trials, BusiestOf(survey, config));
  if (sharpest == nullptr && poses.size() > 1) {
    SPLINEMAP_RETURN_IF_ERROR(CheckStoodStill(survey, poses));
    proposal.cautions.push_back(
        "the robot stood still, so nothing can be told of the flags, and any of the poses gives "
        "this map");
  }
  proposal.pose = sharpest != nullptr ? sharpest->pose : poses.front();
  SPLINEMAP_RETURN_IF_ERROR(CheckOneRobot(proposal));
  proposal.scan_flags = ScanFlags(survey, config, proposal.trials, proposal.pose);
  for (const config::Scan& scan : config.scan()) {
    const FlagTrial* const trial = TrialOf(proposal.trials, scan.channel(), proposal.pose);
    CautionOnExtrinsics(survey, scan, trial, proposal.cautions);
    if (trial != nullptr && trial->flags && trial->flags->is_time_beyond) {
      proposal.problem = ProblemOf(*trial);
    }
  }
  const FlagTrial* const second =
      sharpest != nullptr ? CloseSecond(proposal.trials, *sharpest) : nullptr;
  if (second != nullptr) {
    proposal.cautions.push_back(CloseCall(*sharpest, *second));
    proposal.close_second = {second->pose,
                             ScanFlags(survey, config, proposal.trials, second->pose)};
  }
  return proposal;
}

std::string SharperPoses(const Survey& survey, const config::Config& config) {
  if (ChannelsOf(survey, &IsPose).size() < 2 || config.scan_size() == 0) return "";
  config::Config open = config;
  open.clear_pose();
  const absl::StatusOr<Proposal> proposal = Propose(survey, open);
  if (!proposal.ok() || proposal->pose == config.pose()) return "";
  const std::string& scan = BusiestOf(survey, config);
  const FlagTrial* const chosen = TrialOf(proposal->trials, scan, config.pose());
  const FlagTrial* const sharper = TrialOf(proposal->trials, scan, proposal->pose);
  if (chosen == nullptr || !chosen->flags || !sharper->flags) return "";
  const double cells = chosen->spread_as_given.value_or(chosen->flags->spread);
  if (sharper->flags->spread >= kClearlySharper * cells) return "";
  return fmt::format(
      "{}: the map is sharper with the poses of {}: hits lie in {:.0f} cells of 5 cm, and in "
      "{:.0f} with these",
      config.pose(), proposal->pose, sharper->flags->spread, cells);
}

std::vector<std::string> Remarks(const Survey& survey) {
  std::vector<std::string> remarks;
  for (const SurveyedChannel& channel : survey.channels()) {
    const auto remark = [&]<typename... Args>(fmt::format_string<Args...> text, Args&&... args) {
      remarks.push_back(channel.name + ": " + fmt::format(text, std::forward<Args>(args)...));
    };
    if (channel.malformed > 0) {
      remark("{} of {} messages cannot be used, the first: {}", channel.malformed, channel.messages,
             channel.complaint);
    }
    if (!channel.type || !(IsPose(*channel.type) || IsScan(*channel.type))) continue;
    if (channel.repeated > 0) {
      remark("{} of {} messages repeat the time of the one before; the first counts",
             channel.repeated, channel.messages);
    }
    if (!channel.odd_stamps.empty()) {
      remark("{}", channel.odd_stamps);
      if (IsScan(*channel.type)) {
        remark(
            "better than to correct them here is to correct the sender; the time of reception "
            "(stamp=receive) comes late by the way of the message, and blurs turns");
      }
    }
    const auto complaint = survey.ReadingsOf(channel.name).Complain(config::Scan().range_max_m());
    if (complaint) remark("{}", complaint->text);
    if (const std::string odd = PoseComplaint(survey.PosesOf(channel.name)); !odd.empty()) {
      remark("{}", odd);
    }
    if (channel.stepped_back > 0) {
      remark("message time steps back {} times; two in a row by a second or more begin anew",
             channel.stepped_back);
    }
    if (channel.longest_gap_s > kNonsenseGap_s) {
      remark("a time stamp is years after the one before");
    } else if (channel.longest_gap_s > kLongGap_s) {
      remark("a gap of {:.1f} s between two messages", channel.longest_gap_s);
    }
    if (channel.useless_beam_times && channel.preset == "michigan_2017") {
      remark("its beam times are all the same or none; scan_duration_ms stands in for them");
    }
  }
  RemarkOnClocks(survey, remarks);
  return remarks;
}

}  // namespace splinemap
