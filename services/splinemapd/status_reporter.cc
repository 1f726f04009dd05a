#include "services/splinemapd/status_reporter.h"

#include <cmath>
#include <ctime>
#include <utility>

#include "lcmtypes/splinemap/layer_status_t.hpp"
#include "lib/base/host_clock.h"
#include "lib/base/status.h"
#include "lib/wire/encode.h"
#include "lib/wire/lcm_bus.h"

namespace splinemap {
namespace {

double Seconds(Clock::duration duration) { return std::chrono::duration<double>(duration).count(); }

double Milliseconds(std::chrono::nanoseconds duration) {
  return std::chrono::duration<double, std::milli>(duration).count();
}

// Advances while the computer sleeps, unlike steady_clock.
std::chrono::nanoseconds TimeSinceBoot() {
  timespec time{};
  clock_gettime(CLOCK_BOOTTIME, &time);
  return std::chrono::seconds(time.tv_sec) + std::chrono::nanoseconds(time.tv_nsec);
}

}  // namespace

StatusReporter::StatusReporter(const config::Config& config, const Parts& parts, TileBudget budget)
    : config_(config), parts_(parts), budget_(std::move(budget)) {
  budget_.Share(*parts.newest.Layers());
  for (const config::Scan& scan : config.scan()) {
    extrinsics_channels_.insert(scan.extrinsics_channel());
  }
  for (const std::string& channel : parts.mapping.channels()) {
    silences_.emplace(channel, SilenceWatch(Clock::now()));
  }
}

int64_t StatusReporter::Growth(const std::string& count, int64_t value) {
  return value - std::exchange(counts_[count], value);
}

void StatusReporter::CheckHealth() {
  CheckClock();
  CheckMemory();
  CheckDisk();
  CheckSilence();
  CheckLosses();
  CheckRequests();
  replication_ = parts_.replication.DrainReport();
  CheckReplication(replication_);
  CheckLayers(replication_);
  CheckDuplicateNames();
  CheckContradictions();
  CheckForRobots(replication_);
}

// A base station has nothing to do but to follow.
void StatusReporter::CheckForRobots(const ReplicationThread::Report& report) {
  constexpr std::chrono::seconds kPatience(10);
  if (config_.service().sensors() || said_alone_ || !report.followed.empty()) return;
  if (Clock::now() - started_ < kPatience) return;
  said_alone_ = true;
  parts_.notices.ReportProblem(
      Problem::kSilence, "robots",
      fmt::format("no robot was received on {}_DIGESTS for {} s. LCM's default URL keeps messages "
                  "on their host (ttl=0): between hosts, give all of them --lcm-url "
                  "'udpm://239.255.76.67:7667?ttl=1'",
                  config_.channel_prefix(), kPatience.count()));
}

void StatusReporter::CheckClock() {
  const auto jump = host_clock_.Check(std::chrono::system_clock::now(), TimeSinceBoot());
  if (!jump) return;
  parts_.notices.ReportProblem(
      Problem::kHostClockJump, "",
      fmt::format("the clock of this computer was set {} by {:.1f} s; do all that stamp messages "
                  "follow the same clock?",
                  jump->count() > 0 ? "forward" : "back", std::abs(jump->count())));
}

void StatusReporter::CheckMemory() {
  const size_t enough = budget_.Share(*parts_.newest.Layers());
  const bool is_short = enough > budget_.max_bytes();
  if (is_short && !was_short_) {
    parts_.notices.ReportProblem(
        Problem::kShortMemory, "",
        fmt::format("max_memory_mb is {}; the list of tiles and the scans take {} MB, so that "
                    "hardly any tile is in memory, and {} MB more are taken. Set it to {} at least",
                    budget_.max_bytes() >> 20, (enough - budget_.max_bytes() / 8) >> 20,
                    (enough - budget_.max_bytes()) >> 20, 2 * (enough >> 20)));
  }
  was_short_ = is_short;
}

// The oldest scans go first; then nothing is added any more, until there is room.
void StatusReporter::CheckDisk() {
  const int64_t max_bytes = int64_t{config_.service().max_file_mb()} << 20;
  const int64_t excess = max_bytes == 0 ? 0 : parts_.saver.used_bytes() - max_bytes;
  const LayerSnapshot own = parts_.newest.Own();
  const int64_t scans = own.archive == nullptr ? 0 : static_cast<int64_t>(own.archive->bytes());
  constexpr int64_t kFewScans = 1 << 16;
  std::string why;
  const std::optional<uint64_t> saved = parts_.saver.saved_revision();
  if (excess > 0 && scans > kFewScans &&
      saved != limited_at_) {  // the save after shows what it did
    limited_at_ = saved;
    parts_.mapping.LimitArchive(static_cast<size_t>(std::max(scans - excess, kFewScans)));
  } else if (excess > 0 && scans <= kFewScans) {
    why = fmt::format("the map file has reached max_file_mb, {} MB", max_bytes >> 20);
  }
  if (parts_.saver.unsaved_tiles() * TileMemory::kBytesPerTile > budget_.max_bytes() / 2) {
    why = "the map cannot be saved, and what is not saved fills half of max_memory_mb";
  }
  if (why == why_refused_) return;
  why_refused_ = why;
  parts_.mapping.Refuse(why);
  if (why.empty()) return;
  parts_.notices.ReportProblem(Problem::kNotSaved, "full",
                               why + "; no scan is mapped until there is room");
}

void StatusReporter::CheckSilence() {
  for (auto& [channel, silence] : silences_) {
    const int64_t messages = parts_.receiving.received().at(channel);
    if (messages > 0 && extrinsics_channels_.contains(channel)) continue;  // one may be enough
    switch (silence.Check(messages, Clock::now())) {
      case SilenceWatch::Change::kNone:
        break;
      case SilenceWatch::Change::kHeardAgain:
        parts_.notices.Report({.is_problem = false,
                               .subject = "heard " + channel,
                               .text = channel + " is received again"});
        break;
      case SilenceWatch::Change::kSilent:
        parts_.notices.ReportProblem(
            Problem::kSilence, channel,
            messages == 0
                ? fmt::format("nothing was received on {} for {} s; is the channel right, and the "
                              "LCM URL? splinemap doctor --live shows what is on a bus",
                              channel, SilenceWatch::kSilence.count())
                : fmt::format("nothing was received on {} for {} s", channel,
                              SilenceWatch::kSilence.count()));
    }
  }
}

void StatusReporter::CheckLosses() {
  if (const int64_t more = Growth("datagrams", LcmBus::LostDatagrams()); more > 0) {
    parts_.notices.ReportProblem(
        Problem::kLostDatagrams, "",
        fmt::format("{} datagrams of any channel were lost before splinemapd could receive them; "
                    "raise net.core.rmem_max, and recv_buf_size in the LCM URL",
                    more),
        more);
  }
  if (const int64_t more = Growth("overload", DroppedByOverload()); more > 0) {
    parts_.notices.Report(
        {.subject = "overload",
         .text = fmt::format("dropped {} {}: {}", more, DropName(DropReason::kOverload),
                             DropExplanation(DropReason::kOverload)),
         .times = more});
  }
}

void StatusReporter::CheckRequests() {
  const RequestServer::Counts counts = parts_.requests.counts();
  if (const int64_t more = Growth("refused requests", counts.refused); more > 0) {
    parts_.notices.ReportProblem(
        Problem::kRefusedRequests, "",
        fmt::format("refused {} requests of clients that ask more than can be answered", more),
        more);
  }
  if (const int64_t more = Growth("disbelieved commands", counts.disbelieved); more > 0) {
    parts_.notices.ReportProblem(Problem::kDisbelieved, "commands",
                                 fmt::format("refused {} commands {}", more, counts.why), more);
  }
  if (const int64_t more = Growth("malformed requests", counts.malformed); more > 0) {
    parts_.notices.ReportProblem(
        Problem::kMalformedMessages, "requests",
        fmt::format("ignored {} messages on request channels that are damaged or of another type",
                    more),
        more);
  }
}

void StatusReporter::CheckReplication(const ReplicationThread::Report& report) {
  if (const int64_t more = Growth("malformed", report.malformed); more > 0) {
    parts_.notices.ReportProblem(
        Problem::kMalformedMessages, "layers",
        fmt::format("ignored {} messages on channels of layers that are damaged or of another type",
                    more),
        more);
  }
  for (const auto& [code, disbelieved] : report.disbelieved) {
    const std::string subject = absl::StatusCodeToString(code);
    const int64_t more = Growth("disbelieved " + subject, disbelieved.count);
    if (more == 0) continue;
    parts_.notices.ReportProblem(
        Problem::kDisbelieved, subject,
        fmt::format("ignored {} messages about layers {}{}", more, disbelieved.why,
                    report.believed > 0 ? "" : "; none was heard that is to be believed"),
        more);
  }
  if (const int64_t more = Growth("dropped", report.dropped); more > 0) {
    parts_.notices.ReportProblem(
        Problem::kDroppedUpdates, "",
        fmt::format("{} messages about layers came faster than they could be handled and were "
                    "dropped; what they said is asked for again",
                    more),
        more);
  }
  if (const int64_t more = Growth("refused settings", report.refused_settings); more > 0) {
    parts_.notices.ReportProblem(
        Problem::kRefusedSetting, "",
        fmt::format(
            "{} settings of layers were ignored that no splinemapd makes: their numbers are "
            "beyond all that is known",
            more),
        more);
  }
  if (Growth("ignored settings", report.ignored_settings) > 0) {
    parts_.notices.Report({.subject = "ignored settings",
                           .text =
                               "settings of layers are on the bus and ignored here because of "
                               "--no-remote-commands; others may leave layers out, this robot's "
                               "too"});
  }
}

void StatusReporter::CheckLayers(const ReplicationThread::Report& report) {
  for (const std::string& refused : report.refused) {
    if (!reported_refused_.insert(refused).second) continue;
    parts_.notices.ReportProblem(Problem::kRefusedLayer, refused,
                                 fmt::format("the map leaves out the layer of {}", refused));
  }
  const LayerId own = parts_.newest.Own().id;
  if (report.heard_earlier_session) {
    parts_.notices.ReportProblem(
        Problem::kSharedIdentity, "earlier",
        fmt::format("an earlier session of {} is on the bus: a log is replayed, or another "
                    "splinemapd has a copy of this map file; followers ignore it",
                    own.name));
  }
  for (const LayerId& other : report.same_names) ReportDuplicateName(own, other);
  const bool was_full = std::exchange(was_full_, report.is_full);
  if (was_full_ && !was_full) {
    parts_.notices.ReportProblem(
        Problem::kRefusedLayer, "full",
        fmt::format("the layers of others have reached max_followed_mb, {} MB; the map leaves out "
                    "what is beyond",
                    config_.service().max_followed_mb()));
  }
  const std::map<LayerId, int64_t> before = std::exchange(disowned_, {});
  for (const FollowedLayer& layer : report.followed) {
    disowned_[layer.id] = layer.counts.disowned;
    const auto reported = before.find(layer.id);
    const int64_t more = layer.counts.disowned - (reported == before.end() ? 0 : reported->second);
    if (more <= 0) continue;
    parts_.notices.ReportProblem(
        Problem::kDisownedTiles, layer.id.name,
        fmt::format("{} tiles were published in the name of {} that {} does not have; they were "
                    "dropped or fetched anew. Another process publishes in its name",
                    more, layer.id.name, layer.id.name),
        more);
  }
}

void StatusReporter::CheckDuplicateNames() {
  const auto set = parts_.newest.Layers();
  std::map<std::string, LayerId> first;  // of each name
  for (const LayerSnapshot& layer : set->layers) {
    if (!set->settings.Of(layer.id).IsSummed()) continue;
    const auto [other, is_first] = first.try_emplace(layer.id.name, layer.id);
    if (!is_first) ReportDuplicateName(other->second, layer.id);
  }
}

void StatusReporter::CheckContradictions() {
  if (!contradictions_.Check(parts_.newest)) return;
  const std::set<LayerId> before = std::exchange(contradicting_, {});
  for (const auto& [id, contradiction] : contradictions_.contradictions()) {
    if (!contradiction.IsTooMuch()) {
      if (!before.contains(id)) continue;
      parts_.notices.Report(
          {.is_problem = false,
           .subject = "agrees " + id.name,
           .text = fmt::format("the layer of {} agrees with the others", id.name)});
      continue;
    }
    contradicting_.insert(id);
    if (before.contains(id)) continue;
    parts_.notices.ReportProblem(
        Problem::kContradiction, id.name,
        fmt::format("{} of the layer of {} are where the others saw free space, so its frame may "
                    "be another: splinemap render --live --contradictions shows where, splinemap "
                    "layer places or mutes it",
                    ObstaclesText(contradiction), id.name));
  }
}

void StatusReporter::ReportDuplicateName(const LayerId& first, const LayerId& second) {
  constexpr size_t kMaxReported = 256;
  if (reported_names_.size() >= kMaxReported || !reported_names_.insert(second).second) return;
  parts_.notices.ReportProblem(
      Problem::kSharedName, first.name,
      fmt::format(
          "there are two layers named {}, of the origins {:016x} and {:016x}: two robots of "
          "that name, or an old map file. Followers of {} add up both; splinemap layers "
          "shows them, splinemap layer mutes or removes one",
          first.name, first.origin, second.origin, first.name));
}

layers_t StatusReporter::MakeLayers(const LayerSet& set,
                                    std::vector<layer_status_t> statuses) const {
  layers_t layers{};
  layers.utime = 0;
  layers.daemon_nonce = static_cast<int64_t>(set.layers.front().session.nonce);
  layers.refused = replication_.refused;
  layers.num_refused = static_cast<int32_t>(layers.refused.size());
  layers.name = set.layers.front().id.name;
  layers.settings_hash = static_cast<int64_t>(replication_.settings_hash);
  layers.layers = std::move(statuses);
  layers.num_layers = static_cast<int32_t>(layers.layers.size());
  return layers;
}

std::optional<status_t> StatusReporter::StatusToPublish(Clock::time_point now) {
  status_t status = MakeStatus();
  status_t state = status;
  state.utime = 0;
  state.uptime_s = 0;
  state.newest_scan_age_s = 0;
  if (!status_announcement_.IsDue(Encode(state), replication_.was_called, now)) return std::nullopt;
  return status;
}

std::optional<layers_t> StatusReporter::LayersToPublish(Clock::time_point now) {
  const auto set = parts_.newest.Layers();
  const layers_t outline = MakeLayers(*set, LayerReport::Outline(*set, replication_.followed));
  if (!layers_announcement_.IsDue(Encode(outline), replication_.was_called, now))
    return std::nullopt;
  layers_t layers = MakeLayers(
      *set, layer_report_.Make(*set, replication_.followed, contradictions_.contradictions()));
  layers.utime = HostUtime();
  return layers;
}

int64_t StatusReporter::DroppedByOverload() const {
  return parts_.mapping.dropped() + LcmBus::FailedHandlers();
}

status_t StatusReporter::MakeStatus() {
  const MappingThread::State state = parts_.mapping.DrainState();
  const LayerSnapshot layer = parts_.newest.Own();
  status_t status{};
  status.utime = HostUtime();
  status.name = layer.id.name;
  status.origin = static_cast<int64_t>(layer.id.origin);
  status.session_number = static_cast<int64_t>(layer.session.number);
  status.daemon_nonce = static_cast<int64_t>(layer.session.nonce);
  status.version = SPLINEMAP_VERSION;
  status.uptime_s = Seconds(Clock::now() - started_);

  MapperCounts counts = state.counts;
  const int64_t overload = DroppedByOverload();
  counts.drops[DropReason::kOverload] += overload;
  status.messages_received = counts.messages_received + overload;
  status.bytes_received = counts.bytes_received;
  status.scans_received = counts.scans_received;
  status.poses_received = counts.poses_received;
  status.scans_mapped = counts.scans_mapped;
  status.beams_received = counts.beams_received;
  status.beams_mapped = counts.beams_mapped;
  status.messages_dropped = counts.drops.Total();
  for (int k = 0; k < kNumDropReasons; ++k) {
    const auto reason = static_cast<DropReason>(k);
    if (counts.drops[reason] == 0) continue;
    status.drop_reasons.emplace_back(DropName(reason));
    status.drop_counts.push_back(counts.drops[reason]);
  }
  status.num_drop_reasons = static_cast<int32_t>(status.drop_reasons.size());
  const ProblemCounts problems = parts_.notices.problems();
  for (int k = 0; k < kNumProblems; ++k) {
    const int64_t count = counts.problems[k] + problems[k];
    if (count == 0) continue;
    status.problems.emplace_back(ProblemName(static_cast<Problem>(k)));
    status.problem_counts.push_back(count);
  }
  status.num_problems = static_cast<int32_t>(status.problems.size());

  status.messages_queued = static_cast<int32_t>(state.messages_queued);
  status.scans_queued = static_cast<int32_t>(state.scans_queued);
  status.newest_scan_utime = state.newest_scan_utime.count();
  status.newest_scan_age_s = state.last_mapped ? Seconds(Clock::now() - *state.last_mapped) : -1;
  if (state.scans > 0) {
    status.scan_time_mean_ms = Milliseconds(state.scan_time) / static_cast<double>(state.scans);
    status.scan_time_max_ms = Milliseconds(state.longest_scan_time);
  }

  status.revision = static_cast<int64_t>(layer.revision);
  status.saved_revision = static_cast<int64_t>(parts_.saver.saved_revision().value_or(0));
  status.tiles = static_cast<int64_t>(layer.tiles.size());
  status.map_bytes = status.tiles * static_cast<int64_t>(sizeof(Tile));
  status.last_problem = parts_.notices.last_problem();
  return status;
}

}  // namespace splinemap
