#include <spdlog/spdlog.h>

#include <cmath>
#include <ctime>
#include <map>
#include <string>
#include <utility>

#include "lib/base/host_clock.h"
#include "lib/base/status.h"
#include "services/splinemapd/daemon.h"

// What the daemon says once a second, and what it looks at then.

namespace splinemap {
namespace {

double Seconds(Clock::duration duration) { return std::chrono::duration<double>(duration).count(); }

double Milliseconds(std::chrono::nanoseconds duration) {
  return std::chrono::duration<double, std::milli>(duration).count();
}

// Goes on while the computer sleeps, unlike steady_clock.
std::chrono::nanoseconds TimeSinceBoot() {
  timespec time{};
  clock_gettime(CLOCK_BOOTTIME, &time);
  return std::chrono::seconds(time.tv_sec) + std::chrono::nanoseconds(time.tv_nsec);
}

}  // namespace

void Daemon::PublishStatus() {
  LookAround();
  bus_->Publish(config_.channel_prefix() + "_STATUS", Status());
  bus_->Publish(config_.channel_prefix() + "_LAYERS", Layers());
}

void Daemon::LookAround() {
  if (const auto jump = host_clock_.Look(std::chrono::system_clock::now(), TimeSinceBoot())) {
    Find(
        Symptom::kHostClockJump, "",
        fmt::format("the clock of this computer was set {} by {:.1f} s; do all that stamp messages "
                    "follow the same clock?",
                    jump->count() > 0 ? "forward" : "back", std::abs(jump->count())));
  }
  const std::vector<std::string>& channels = mapper_->channels();
  for (size_t k = 0; k < channels.size(); ++k) {
    const int64_t messages = heard_[k];
    if (messages > 0 && extrinsics_channels_.contains(channels[k])) continue;  // one may be enough
    switch (silences_[k].Look(messages, Clock::now())) {
      case SilenceWatch::Change::kNone:
        break;
      case SilenceWatch::Change::kHeardAgain:
        Report({.is_problem = false,
                .subject = "heard " + channels[k],
                .text = channels[k] + " is heard again"});
        break;
      case SilenceWatch::Change::kSilent:
        Find(
            Symptom::kSilence, channels[k],
            messages == 0
                ? fmt::format("nothing came on {} for {} s; is the channel right, and the LCM URL? "
                              "splinemap doctor --live shows what is on a bus",
                              channels[k], SilenceWatch::kSilence.count())
                : fmt::format("{} is silent since {} s", channels[k],
                              SilenceWatch::kSilence.count()));
    }
  }
  LookForLosses();
  if (queries_) LookAtQueries();
  if (keeper_) LookAtLayers();
}

void Daemon::LookAtLayers() {
  for (const std::string& refused : keeper_->Refused()) {
    if (!noticed_refused_.insert(refused).second) continue;
    Find(Symptom::kRefusedLayer, refused,
         fmt::format("the layer of {}, so it is not in the map", refused));
  }
  const bool was_full = std::exchange(noticed_full_, keeper_->IsFull());
  if (noticed_full_ && !was_full) {
    Find(Symptom::kRefusedLayer, "full",
         fmt::format("the layers of others have reached max_followed_mb, {} MB; what is beyond is "
                     "not in the map",
                     config_.service().max_followed_mb()));
  }
  const std::map<LayerId, int64_t> before = std::exchange(noticed_disowned_, {});
  for (const FollowedLayer& layer : keeper_->Layers()) {
    noticed_disowned_[layer.id] = layer.counts.disowned;
    const auto noticed = before.find(layer.id);
    const int64_t more = layer.counts.disowned - (noticed == before.end() ? 0 : noticed->second);
    if (more <= 0) continue;
    Find(Symptom::kDisownedTiles, layer.id.name,
         fmt::format("{} tiles came in the name of {} that {} does not have; they were dropped or "
                     "fetched anew. Somebody else publishes in its name",
                     more, layer.id.name, layer.id.name),
         more);
  }
  const int64_t decisions = keeper_->RefusedDecisions();
  if (const int64_t more = decisions - std::exchange(noticed_decisions_, decisions); more > 0) {
    Find(Symptom::kRefusedDecision, "",
         fmt::format("{} decisions about layers came over the bus that no splinemapd makes, and "
                     "were ignored: their numbers are beyond all that is known",
                     more),
         more);
  }
  const int64_t ignored = keeper_->IgnoredDecisions();
  if (ignored > std::exchange(noticed_ignored_, ignored)) {
    Report({.subject = "ignored decisions",
            .text = "decisions about layers are on the bus, and not taken here because of "
                    "--no-remote-commands; others may leave layers out, this robot's as well"});
  }
  const auto map = sum_->Snapshot();
  std::map<std::string, LayerId> first;  // of each name
  for (const LayerSnapshot& layer : map->layers) {
    if (!map->controls.Of(layer.id).IsSummed()) continue;
    const auto [other, is_first] = first.try_emplace(layer.id.name, layer.id);
    if (!is_first) FindNamesakes(other->second, layer.id);
  }
}

layers_t Daemon::Layers() {
  layers_t layers;
  layers.utime = HostUtime();
  layers.daemon_nonce = static_cast<int64_t>(daemon_nonce_);
  layers.refused = keeper_ ? keeper_->Refused() : std::vector<std::string>();
  layers.num_refused = static_cast<int32_t>(layers.refused.size());
  const auto map = sum_->Snapshot();
  layers.name = map->layers.front().id.name;
  layers.control_hash =
      static_cast<int64_t>(keeper_ ? keeper_->Controls().hash() : map->controls.hash());
  const std::vector<FollowedLayer> followed =
      keeper_ ? keeper_->Layers() : std::vector<FollowedLayer>();
  layers.layers = roll_.Call(*map, followed);
  layers.num_layers = static_cast<int32_t>(layers.layers.size());
  return layers;
}

void Daemon::LookForLosses() {
  const int64_t lost = LcmBus::LostDatagrams();
  if (const int64_t more = lost - std::exchange(lost_datagrams_, lost); more > 0) {
    Find(Symptom::kLostDatagrams, "",
         fmt::format("{} datagrams were lost before splinemapd could take them, of any channel; "
                     "raise net.core.rmem_max, and recv_buf_size in the LCM URL",
                     more),
         more);
  }
  const int64_t dropped = DroppedByOverload();
  if (const int64_t more = dropped - std::exchange(dropped_by_overload_, dropped); more > 0) {
    Report({.subject = "overload",
            .text = fmt::format("dropped {} {}: {}", more, DropName(DropReason::kOverload),
                                DropExplanation(DropReason::kOverload)),
            .times = more});
  }
}

void Daemon::LookAtQueries() {
  const QueryServer::Counts counts = queries_->counts();
  const int64_t refused = counts.refused - noticed_queries_.refused;
  const int64_t malformed = counts.malformed - noticed_queries_.malformed;
  noticed_queries_ = counts;
  if (refused > 0) {
    Report({.subject = "refused requests",
            .text = fmt::format("refused {} requests of clients that ask more than can be answered",
                                refused),
            .times = refused});
  }
  if (malformed > 0) {
    Report({.subject = "malformed requests",
            .text = fmt::format("ignored {} messages on channels of requests that are damaged or "
                                "of another type",
                                malformed),
            .times = malformed});
  }
}

int64_t Daemon::DroppedByOverload() const { return ingest_.dropped() + LcmBus::FailedHandlers(); }

status_t Daemon::Status() {
  status_t status;
  status.utime = HostUtime();
  status.version = SPLINEMAP_VERSION;
  status.uptime_s = Seconds(Clock::now() - started_);
  status.messages_queued = static_cast<int32_t>(ingest_.size());

  MutexLock lock(mutex_);
  const LayerSnapshot& layer = state_.map->layers.front();
  status.name = layer.id.name;
  status.origin = static_cast<int64_t>(layer.id.origin);
  status.incarnation = static_cast<int64_t>(layer.epoch.incarnation);
  status.nonce = static_cast<int64_t>(layer.epoch.nonce);

  MapperCounts counts = state_.counts;
  const int64_t overload = DroppedByOverload();
  counts.drops[DropReason::kOverload] += overload;
  status.messages_received = counts.messages_received + overload;
  status.bytes_received = counts.bytes_received;
  status.scans_received = counts.scans_received;
  status.poses_received = counts.poses_received;
  status.scans_mapped = counts.scans_mapped;
  status.beams_mapped = counts.beams_mapped;
  status.messages_dropped = counts.drops.Total();
  for (int k = 0; k < kNumDropReasons; ++k) {
    const auto reason = static_cast<DropReason>(k);
    if (counts.drops[reason] == 0) continue;
    status.drop_reasons.emplace_back(DropName(reason));
    status.drop_counts.push_back(counts.drops[reason]);
  }
  status.num_drop_reasons = static_cast<int32_t>(status.drop_reasons.size());
  for (int k = 0; k < kNumSymptoms; ++k) {
    const int64_t count = counts.symptoms[k] + state_.symptoms[k];
    if (count == 0) continue;
    status.problems.emplace_back(SymptomName(static_cast<Symptom>(k)));
    status.problem_counts.push_back(count);
  }
  status.num_problems = static_cast<int32_t>(status.problems.size());

  status.scans_queued = static_cast<int32_t>(state_.scans_queued);
  status.newest_scan_utime = state_.newest_scan_utime.count();
  status.newest_scan_age_s =
      counts.scans_mapped > 0 ? Seconds(Clock::now() - state_.last_mapped) : -1;
  if (state_.scan_times.scans > 0) {
    status.scan_time_mean_ms =
        Milliseconds(state_.scan_times.total) / static_cast<double>(state_.scan_times.scans);
    status.scan_time_max_ms = Milliseconds(state_.scan_times.longest);
  }
  state_.scan_times = {};

  status.revision = static_cast<int64_t>(layer.revision);
  status.saved_revision = static_cast<int64_t>(state_.saved_revision.value_or(0));
  status.tiles = static_cast<int64_t>(layer.tiles.size());
  status.map_bytes = status.tiles * static_cast<int64_t>(sizeof(Tile));
  status.last_problem = state_.last_problem;
  return status;
}

}  // namespace splinemap
