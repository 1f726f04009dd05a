#include "services/splinemapd/daemon.h"

#include <spdlog/spdlog.h>

#include <algorithm>
#include <utility>

#include "lib/base/random.h"
#include "lib/base/status.h"

namespace splinemap {
namespace {

using std::chrono::milliseconds;
using std::chrono::steady_clock;

// How soon threads notice that they are to end.
constexpr milliseconds kPatience(50);
// Messages that are still under way when the daemon ends are received for at most this long.
constexpr milliseconds kMaxDrain(2000);

double Seconds(steady_clock::duration duration) {
  return std::chrono::duration<double>(duration).count();
}

double Milliseconds(std::chrono::nanoseconds duration) {
  return std::chrono::duration<double, std::milli>(duration).count();
}

absl::Status CheckMethod(const config::Method& method, const MapOptions& file, std::string path) {
  const MapOptions wanted = MapOptionsOf(method);
  const bool fits =
      (!method.has_knot_interval_m() || wanted.knot_interval_m == file.knot_interval_m) &&
      (!method.has_clamp_min() || wanted.limits.min == file.limits.min) &&
      (!method.has_clamp_max() || wanted.limits.max == file.limits.max);
  if (fits) return absl::OkStatus();
  return FailedPrecondition(
      "{} was made with knot_interval_m {}, clamp_min {} and clamp_max {}, and the configuration "
      "says otherwise; give another file with --map, or these values",
      path, file.knot_interval_m, file.limits.min / double{kUnitsPerLogOdds},
      file.limits.max / double{kUnitsPerLogOdds});
}

}  // namespace

absl::StatusOr<std::unique_ptr<Daemon>> Daemon::Start(const config::Config& config,
                                                      std::unique_ptr<LcmBus> bus) {
  SPLINEMAP_RETURN_IF_ERROR(CheckConfig(config));
  SPLINEMAP_ASSIGN_OR_RETURN(MapFile file, MapFile::Open(MapPath(config)));
  std::unique_ptr<Daemon> daemon(new Daemon(config, std::move(bus), std::move(file)));
  SPLINEMAP_RETURN_IF_ERROR(daemon->OpenMap());
  daemon->saving_ = std::jthread([d = daemon.get()](std::stop_token s) { d->SaveNowAndThen(s); });
  daemon->mapping_ = std::jthread([d = daemon.get()](std::stop_token s) { d->MapMessages(s); });
  daemon->receiving_ = std::jthread([d = daemon.get()](std::stop_token s) { d->Receive(s); });
  return daemon;
}

Daemon::Daemon(const config::Config& config, std::unique_ptr<LcmBus> bus, MapFile file)
    : config_(config),
      bus_(std::move(bus)),
      ingest_(size_t{config.service().max_queued_mb()} << 20),
      file_(std::move(file)) {}

Daemon::~Daemon() {
  if (absl::Status status = Stop(); !status.ok()) spdlog::error("{}", ErrorText(status));
}

absl::Status Daemon::OpenMap() {
  const std::string name = RobotName(config_);
  const std::string path = MapPath(config_);
  {
    MutexLock map_lock(map_mutex_);
    MutexLock file_lock(file_mutex_);
    SPLINEMAP_ASSIGN_OR_RETURN(const bool is_empty, file_.IsEmpty());
    LoadedMap loaded;
    if (is_empty) {
      map_ = std::make_unique<Map>(MapOptionsOf(config_.method()));
    } else {
      SPLINEMAP_ASSIGN_OR_RETURN(loaded, file_.Load());
      for (const std::string& damage : loaded.damages) spdlog::error("{}", damage);
      SPLINEMAP_RETURN_IF_ERROR(CheckMethod(config_.method(), loaded.map->options, path));
      map_ = std::make_unique<Map>(loaded.map->options);
      config_.mutable_method()->set_knot_interval_m(loaded.map->options.knot_interval_m);
      SPLINEMAP_RETURN_IF_ERROR(CheckConfig(config_));
      for (const LayerSnapshot& layer : loaded.map->layers) {
        // A start takes the next incarnation, so that nothing of an earlier life is taken for new.
        if (layer_ == nullptr && layer.id.name == name) {
          layer_ = &map_->ContinueLayer(layer, {layer.epoch.incarnation + 1, RandomId()});
        } else {
          map_->ContinueLayer(layer, layer.epoch);
        }
      }
    }
    if (layer_ == nullptr) layer_ = &map_->AddLayer({name, RandomId()}, {1, RandomId()});
    mapper_ = std::make_unique<Mapper>(config_, map_->options(), *layer_);
    spdlog::info("map {}: layer {}, start {}, {} tiles", path, name, layer_->epoch().incarnation,
                 layer_->tiles().size());
    for (const std::string& channel : mapper_->channels()) {
      bus_->Subscribe(channel, [this](const std::string& c, absl::Span<const uint8_t> message) {
        ingest_.Push(c, message);
      });
      spdlog::info("listening on {}", channel);
    }
  }
  return Save();  // the new incarnation
}

void Daemon::Receive(std::stop_token stop) {
  while (!stop.stop_requested()) bus_->Handle(kPatience);
  const auto deadline = steady_clock::now() + kMaxDrain;
  while (bus_->Handle(milliseconds(0)) && steady_clock::now() < deadline) {
  }
}

void Daemon::MapMessages(std::stop_token stop) {
  while (true) {
    const bool stopping = stop.stop_requested();
    const auto message = ingest_.Pop(stopping ? milliseconds(0) : kPatience);
    if (message) MapOne(*message);
    if (stopping && !message) break;
  }
  MutexLock lock(map_mutex_);
  mapper_->Flush();
  LogNotices();
}

void Daemon::MapOne(const IngestedMessage& message) {
  MutexLock lock(map_mutex_);
  const uint64_t revision_before = layer_->revision();
  const auto begin = steady_clock::now();
  mapper_->HandleMessage(message.channel, message.bytes);
  const auto end = steady_clock::now();
  if (const auto scans = static_cast<int64_t>(layer_->revision() - revision_before); scans > 0) {
    scan_times_.scans += scans;
    scan_times_.total += end - begin;
    scan_times_.longest = std::max(scan_times_.longest, (end - begin) / scans);
    last_mapped_ = end;
  }
  LogNotices();
}

void Daemon::LogNotices() ABSL_NO_THREAD_SAFETY_ANALYSIS {
  for (const Notice& notice : mapper_->TakeNotices()) {
    spdlog::log(notice.is_problem ? spdlog::level::warn : spdlog::level::info, "{}", notice.text);
    if (notice.is_problem) last_problem_ = notice.text;
  }
}

void Daemon::SaveNowAndThen(std::stop_token stop) {
  Mutex sleep_mutex;
  ConditionVariable sleep;
  while (true) {
    std::unique_lock lock(sleep_mutex);
    sleep.wait_for(lock, stop, std::chrono::duration<double>(config_.service().save_interval_s()),
                   [] { return false; });
    if (stop.stop_requested()) return;
    if (absl::Status status = Save(); !status.ok()) {
      spdlog::error("the map is not saved: {}", ErrorText(status));
      MutexLock map_lock(map_mutex_);
      last_problem_ = ErrorText(status);
    }
  }
}

absl::Status Daemon::Save() {
  std::shared_ptr<const MapSnapshot> snapshot;
  uint64_t revision = 0;
  {
    MutexLock lock(map_mutex_);
    revision = layer_->revision();
    if (saved_revision_ == revision) return absl::OkStatus();
    snapshot = map_->Snapshot();
  }
  {
    MutexLock lock(file_mutex_);
    SPLINEMAP_RETURN_IF_ERROR(file_.Save(*snapshot));
  }
  MutexLock lock(map_mutex_);
  saved_revision_ = revision;
  return absl::OkStatus();
}

void Daemon::PublishStatus() { bus_->Publish(config_.channel_prefix() + "_STATUS", Status()); }

status_t Daemon::Status() {
  status_t status;
  status.utime = std::chrono::duration_cast<std::chrono::microseconds>(
                     std::chrono::system_clock::now().time_since_epoch())
                     .count();
  status.version = SPLINEMAP_VERSION;
  status.messages_queued = static_cast<int32_t>(ingest_.size());

  MutexLock lock(map_mutex_);
  const auto now = steady_clock::now();
  status.uptime_s = Seconds(now - started_);
  status.name = layer_->id().name;
  status.origin = static_cast<int64_t>(layer_->id().origin);
  status.incarnation = static_cast<int64_t>(layer_->epoch().incarnation);
  status.nonce = static_cast<int64_t>(layer_->epoch().nonce);

  MapperCounts counts = mapper_->counts();
  counts.drops[DropReason::kOverload] += ingest_.dropped();
  status.messages_received = counts.messages_received + ingest_.dropped();
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

  status.scans_queued = static_cast<int32_t>(mapper_->scans_queued());
  status.newest_scan_utime = mapper_->newest_scan_utime().count();
  status.newest_scan_age_s = counts.scans_mapped > 0 ? Seconds(now - last_mapped_) : -1;
  if (scan_times_.scans > 0) {
    status.scan_time_mean_ms =
        Milliseconds(scan_times_.total) / static_cast<double>(scan_times_.scans);
    status.scan_time_max_ms = Milliseconds(scan_times_.longest);
  }
  scan_times_ = {};

  status.revision = static_cast<int64_t>(layer_->revision());
  status.saved_revision = static_cast<int64_t>(saved_revision_.value_or(0));
  status.tiles = static_cast<int64_t>(layer_->tiles().size());
  status.map_bytes = status.tiles * static_cast<int64_t>(sizeof(Tile));
  status.last_problem = last_problem_;
  return status;
}

absl::Status Daemon::Stop() {
  if (!receiving_.joinable()) return absl::OkStatus();
  // In the order of the data, so that each thread gets all that the one before has left.
  for (std::jthread* thread : {&receiving_, &mapping_, &saving_}) {
    thread->request_stop();
    thread->join();
  }
  SPLINEMAP_RETURN_IF_ERROR(Save());
  PublishStatus();
  const status_t status = Status();
  spdlog::info("mapped {} of {} scans with {} poses; {} tiles, saved to {}", status.scans_mapped,
               status.scans_received, status.poses_received, status.tiles, MapPath(config_));
  for (int k = 0; k < status.num_drop_reasons; ++k) {
    spdlog::info("dropped {} {}", status.drop_counts[k], status.drop_reasons[k]);
  }
  return absl::OkStatus();
}

}  // namespace splinemap
