#include "services/splinemapd/daemon.h"

#include <spdlog/spdlog.h>

#include <algorithm>
#include <cmath>
#include <ctime>
#include <utility>

#include "absl/strings/escaping.h"
#include "lib/base/random.h"
#include "lib/base/status.h"
#include "lib/wire/decode.h"

namespace splinemap {
namespace {

using std::chrono::milliseconds;

// How soon threads notice that they are to end.
constexpr milliseconds kPatience(50);
// How old at most what others see of the map is, while messages pour in.
constexpr milliseconds kShowInterval(20);
// How often the identity of the layer is looked at, and how soon tried again where it fails.
constexpr milliseconds kIdentityInterval(500);
// Messages that are still under way when the daemon ends are received for at most this long.
constexpr milliseconds kMaxDrain(2000);

double Seconds(std::chrono::steady_clock::duration duration) {
  return std::chrono::duration<double>(duration).count();
}

double Milliseconds(std::chrono::nanoseconds duration) {
  return std::chrono::duration<double, std::milli>(duration).count();
}

absl::Status CheckMethod(const config::Method& method, const MapOptions& file, std::string path) {
  const MapOptions wanted = MapOptionsOf(method);
  const bool asks_for_min = method.has_preset() || method.has_clamp_min();
  const bool asks_for_max = method.has_preset() || method.has_clamp_max();
  const bool fits =
      (!method.has_knot_interval_m() || wanted.knot_interval_m == file.knot_interval_m) &&
      (!asks_for_min || wanted.limits.min == file.limits.min) &&
      (!asks_for_max || wanted.limits.max == file.limits.max);
  if (fits) return absl::OkStatus();
  return FailedPrecondition(
      "{} was made with knot_interval_m {}, clamp_min {} and clamp_max {}, and the configuration "
      "says otherwise; give another file with --map, or these values",
      path, file.knot_interval_m, file.limits.min / double{kUnitsPerLogOdds},
      file.limits.max / double{kUnitsPerLogOdds});
}

// Goes on while the computer sleeps, unlike steady_clock.
std::chrono::nanoseconds TimeSinceBoot() {
  timespec time{};
  clock_gettime(CLOCK_BOOTTIME, &time);
  return std::chrono::seconds(time.tv_sec) + std::chrono::nanoseconds(time.tv_nsec);
}

}  // namespace

absl::StatusOr<std::unique_ptr<Daemon>> Daemon::Start(const config::Config& config,
                                                      std::unique_ptr<LcmBus> bus) {
  SPLINEMAP_RETURN_IF_ERROR(CheckConfig(config));
  SPLINEMAP_ASSIGN_OR_RETURN(MapFile file, MapFile::Open(MapPath(config)));
  std::unique_ptr<Daemon> daemon(new Daemon(config, std::move(bus), std::move(file)));
  SPLINEMAP_RETURN_IF_ERROR(daemon->OpenMap());
  daemon->Serve();
  daemon->saving_ =
      std::jthread([d = daemon.get()](const std::stop_token& s) { d->SaveNowAndThen(s); });
  daemon->mapping_ =
      std::jthread([d = daemon.get()](const std::stop_token& s) { d->MapMessages(s); });
  daemon->receiving_ =
      std::jthread([d = daemon.get()](const std::stop_token& s) { d->Receive(s); });
  return daemon;
}

void Daemon::Serve() {
  using Duration = std::chrono::duration<double, std::milli>;
  const config::Service& service = config_.service();
  PublisherOptions options;
  options.bytes_per_s = service.max_publish_kb_per_s() * 1000;
  options.push_interval =
      std::chrono::duration_cast<milliseconds>(Duration(service.push_interval_ms()));
  // First, since on tcpq subscribing and publishing at once, by the server's thread, is no good.
  bus_->Subscribe(LayerServer::PullChannel(config_.channel_prefix()),
                  [this](const std::string&, absl::Span<const uint8_t> message) {
                    LookAtPull(message);
                    server_->TakePull(message);
                  });
  bus_->Subscribe(
      config_.channel_prefix() + "_DIGESTS",
      [this](const std::string&, absl::Span<const uint8_t> message) { LookAtDigest(message); });
  for (const std::string& channel : QueryServer::Channels(config_.channel_prefix())) {
    bus_->Subscribe(channel, [this](const std::string&, absl::Span<const uint8_t> message) {
      queries_->TakeRequest(message);
    });
  }
  bus_->Subscribe(config_.channel_prefix() + kCommandChannel,
                  [this](const std::string&, absl::Span<const uint8_t> message) {
                    commands_->TakeRequest(message);
                  });
  const auto take_snapshot = [this] {
    MutexLock lock(mutex_);
    return state_.map;
  };
  server_ = std::make_unique<LayerServer>(*bus_, config_.channel_prefix(), options, own_layer_,
                                          take_snapshot);
  const Replier replier{
      .channel_prefix = config_.channel_prefix(),
      .daemon_nonce = RandomId(),
      .layer = own_layer_,
      .take_snapshot = take_snapshot,
      .send = [this](const std::string& channel, absl::Span<const uint8_t> reply) {
        bus_->PublishBytes(channel, reply);
      }};
  queries_ = std::make_unique<QueryServer>(replier);
  commands_ = std::make_unique<CommandServer>(
      replier, service.remote_commands(), [this](const std::string& command, uint64_t incarnation) {
        return Do(command, incarnation);
      });
}

LayerLife Daemon::OwnLife() {
  MutexLock lock(mutex_);
  const LayerSnapshot& layer = state_.map->layers[own_layer_];
  return {layer.id, layer.epoch, {}};
}

// Followers take the later of two lives of a layer for the layer.
void Daemon::LookAtDigest(absl::Span<const uint8_t> message) {
  const absl::StatusOr<layer_digest_t> digest = DecodeLayerDigest(message);
  if (!digest.ok()) return;
  const LayerLife heard = FromMessage(digest->layer);
  const LayerLife own = OwnLife();
  if (heard.id != own.id || heard.epoch == own.epoch) return;
  {
    MutexLock lock(mutex_);
    if (heard == former_life_) return;
  }
  if (heard.epoch < own.epoch) {
    Find(Symptom::kSharedIdentity, "earlier",
         fmt::format("an earlier start of {} is on the bus: a replayed log, or a splinemapd with a "
                     "copy of this map file; followers ignore it",
                     own.id.name));
    return;
  }
  MutexLock lock(mutex_);
  identity_.TakeDigest(heard, own);
}

void Daemon::LookAtPull(absl::Span<const uint8_t> message) {
  const absl::StatusOr<layer_pull_t> pull = DecodeLayerPull(message);
  if (!pull.ok()) return;
  const LayerLife own = OwnLife();
  MutexLock lock(mutex_);
  identity_.TakePull(FromMessage(pull->layer), own, Clock::now());
}

void Daemon::LookAtIdentity() {
  const auto now = Clock::now();
  if (now < next_identity_look_) return;
  next_identity_look_ = now + kIdentityInterval;
  const LayerLife own = OwnLife();
  std::optional<IdentityWatch::NextLife> next;
  {
    MutexLock lock(mutex_);
    next = identity_.Next(own, now, RandomId());
  }
  if (!next) return;
  if (const absl::Status begun = BeginLife(next->life, /*is_empty=*/false); !begun.ok()) {
    Report({.subject = "identity",
            .text = "another start of this layer is on the bus, and no new one can be saved: " +
                    ErrorText(begun)});
    return;
  }
  Find(Symptom::kSharedIdentity, "later",
       next->is_other_layer
           ? fmt::format("a later start of {} is on the bus: a splinemapd with a copy of this map "
                         "file, or a replayed log of one. So this one goes on as another layer, "
                         "origin {:016x}; what was mapped before the copy counts twice for those "
                         "who follow both",
                         own.id.name, next->life.id.origin)
           : fmt::format("followers know a later start of {} than start {}, so {} is an older "
                         "copy; it goes on as start {}, and followers take that for the map",
                         own.id.name, own.epoch.incarnation, MapPath(config_),
                         next->life.epoch.incarnation));
}

// On disk first, so that no later start takes the same life.
absl::Status Daemon::BeginLife(const LayerLife& life, bool is_empty) {
  MutexLock lock(file_mutex_);
  MapSnapshot map = *map_->Snapshot();
  map.layers[own_layer_].id = life.id;
  map.layers[own_layer_].epoch = life.epoch;
  if (is_empty) {
    map.layers[own_layer_].tiles = {};
    ++map.layers[own_layer_].revision;
  }
  SPLINEMAP_RETURN_IF_ERROR(file_.Save(map));
  {
    MutexLock state_lock(mutex_);
    former_life_ = {state_.map->layers[own_layer_].id, state_.map->layers[own_layer_].epoch, {}};
  }
  if (is_empty) {
    map_->layer(own_layer_).BeginEmptyLife(life.epoch);
  } else {
    map_->layer(own_layer_).BeginLife(life.id, life.epoch);
  }
  ShowState();
  return absl::OkStatus();
}

absl::Status Daemon::Do(const std::string& command, uint64_t incarnation) {
  SPLINEMAP_RETURN_IF_ERROR(CheckIncarnation(incarnation));
  if (command == "save") return Save();
  if (command != "clear") {
    return InvalidArgument("no such command: {}; there are save and clear",
                           absl::Utf8SafeCHexEscape(command.substr(0, 20)));
  }
  return DoWhereMapped([this, incarnation]() -> absl::Status {
    SPLINEMAP_RETURN_IF_ERROR(CheckIncarnation(incarnation));
    LayerLife life = OwnLife();
    life.epoch = {life.epoch.incarnation + 1, RandomId()};
    SPLINEMAP_RETURN_IF_ERROR(BeginLife(life, /*is_empty=*/true));
    Report({.is_problem = false,
            .subject = "clear",
            .text = fmt::format("a client cleared the map; it goes on as start {}",
                                life.epoch.incarnation)});
    return absl::OkStatus();
  });
}

absl::Status Daemon::CheckIncarnation(uint64_t incarnation) {
  const uint64_t own = OwnLife().epoch.incarnation;
  if (own == incarnation) return absl::OkStatus();
  return FailedPrecondition("the command is for start {} of the layer, which is in start {}",
                            incarnation, own);
}

absl::Status Daemon::DoWhereMapped(std::function<absl::Status()> errand) {
  std::future<absl::Status> done;
  {
    MutexLock lock(mutex_);
    errand_ = std::packaged_task<absl::Status()>(std::move(errand));
    done = errand_.get_future();
  }
  return done.get();
}

void Daemon::RunErrand() {
  std::packaged_task<absl::Status()> errand;
  {
    MutexLock lock(mutex_);
    errand.swap(errand_);
  }
  if (errand.valid()) errand();
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
  SPLINEMAP_RETURN_IF_ERROR(LoadMap(name));
  // The layer is the mapper's from here on; everybody else sees snapshots.
  Layer& layer = map_->layer(own_layer_);
  mapper_ = std::make_unique<Mapper>(config_, map_->options(), layer);
  spdlog::info("map {}: layer {}, start {}, {} tiles", MapPath(config_), name,
               layer.epoch().incarnation, layer.tiles().size());
  for (const config::Scan& scan : config_.scan()) {
    extrinsics_channels_.insert(scan.extrinsics_channel());
  }
  for (const std::string& channel : mapper_->channels()) {
    silences_.emplace_back(Clock::now());
    std::atomic<int64_t>& heard = heard_.emplace_back(0);
    bus_->Subscribe(channel,
                    [this, &heard](const std::string& c, absl::Span<const uint8_t> message) {
                      ++heard;
                      ingest_.Push(c, message);
                    });
    spdlog::info("listening on {}", channel);
  }
  ShowState();
  return Save();  // the new incarnation
}

absl::Status Daemon::LoadMap(const std::string& name) {
  MutexLock lock(file_mutex_);
  SPLINEMAP_ASSIGN_OR_RETURN(const bool is_empty, file_.IsEmpty());
  bool has_own_layer = false;
  if (is_empty) {
    map_ = std::make_unique<Map>(MapOptionsOf(config_.method()));
  } else {
    SPLINEMAP_ASSIGN_OR_RETURN(const LoadedMap loaded, file_.Load());
    ReportDamages(loaded.damages);
    const MapOptions& options = loaded.map->options;
    SPLINEMAP_RETURN_IF_ERROR(CheckMethod(config_.method(), options, MapPath(config_)));
    map_ = std::make_unique<Map>(options);
    config_.mutable_method()->set_knot_interval_m(options.knot_interval_m);
    SPLINEMAP_RETURN_IF_ERROR(CheckConfig(config_));
    for (const LayerSnapshot& layer : loaded.map->layers) {
      LayerEpoch epoch = layer.epoch;
      if (!has_own_layer && layer.id.name == name) {
        // A start takes the next incarnation, so that nothing of an earlier life is taken for new.
        epoch = {layer.epoch.incarnation + 1, RandomId()};
        own_layer_ = map_->layers().size();
        has_own_layer = true;
      }
      map_->ContinueLayer(layer, epoch);
    }
  }
  if (!has_own_layer) {
    own_layer_ = map_->layers().size();
    map_->AddLayer({name, RandomId()}, {1, RandomId()});
  }
  return absl::OkStatus();
}

void Daemon::ReportDamages(const std::vector<std::string>& damages) {
  if (damages.empty()) return;
  constexpr size_t kMaxLines = 5;
  std::string text = fmt::format("{}: {} damages, of which the next save leaves nothing",
                                 MapPath(config_), damages.size());
  for (size_t k = 0; k < std::min(damages.size(), kMaxLines); ++k) text += "; " + damages[k];
  Report({.subject = "damage", .text = absl::Utf8SafeCHexEscape(text)});
}

void Daemon::Receive(const std::stop_token& stop) {
  bool is_broken = false;
  while (!stop.stop_requested()) {
    const LcmBus::Handled handled = bus_->Handle(kPatience);
    if (handled == LcmBus::Handled::kBroken && !std::exchange(is_broken, true)) {
      Report({.subject = "bus", .text = "the LCM bus does not work any more; nothing is received"});
    }
  }
  const auto deadline = Clock::now() + kMaxDrain;
  while (bus_->Handle(milliseconds(0)) == LcmBus::Handled::kMessage && Clock::now() < deadline) {
  }
}

void Daemon::MapMessages(const std::stop_token& stop) {
  auto last_shown = Clock::now();
  bool is_shown = true;
  while (true) {
    const bool stopping = stop.stop_requested();
    const auto message = ingest_.Pop(is_shown && !stopping ? kPatience : milliseconds(0));
    if (message) MapOne(*message);
    LookAtIdentity();
    RunErrand();
    is_shown = is_shown && !message;
    if (!is_shown && (!message || Clock::now() - last_shown > kShowInterval)) {
      ShowState();
      last_shown = Clock::now();
      is_shown = true;
    }
    if (stopping && !message) break;
  }
  mapper_->Flush();
  ShowState();
}

void Daemon::MapOne(const IngestedMessage& message) {
  const Layer& layer = map_->layer(own_layer_);
  const uint64_t revision_before = layer.revision();
  const auto begin = Clock::now();
  mapper_->HandleMessage(message.channel, message.bytes);
  const auto end = Clock::now();
  if (const auto scans = static_cast<int64_t>(layer.revision() - revision_before); scans > 0) {
    scan_times_.scans += scans;
    scan_times_.total += end - begin;
    scan_times_.longest = std::max(scan_times_.longest, (end - begin) / scans);
    last_mapped_ = end;
  }
}

void Daemon::ShowState() {
  for (const Notice& notice : mapper_->TakeNotices()) {
    Report(notice);
  }
  auto snapshot = map_->Snapshot();
  MutexLock lock(mutex_);
  state_.map = std::move(snapshot);
  state_.counts = mapper_->counts();
  state_.scans_queued = mapper_->scans_queued();
  state_.newest_scan_utime = mapper_->newest_scan_utime();
  state_.last_mapped = last_mapped_;
  state_.scan_times.scans += scan_times_.scans;
  state_.scan_times.total += scan_times_.total;
  state_.scan_times.longest = std::max(state_.scan_times.longest, scan_times_.longest);
  scan_times_ = {};
}

void Daemon::Report(const Notice& notice) {
  std::optional<std::string> text;
  {
    MutexLock lock(mutex_);
    if (notice.is_problem) state_.last_problem = notice.text;
    text = limiter_.Say(notice, Clock::now());
  }
  // Outside of the lock: a terminal may keep it waiting.
  if (text) spdlog::log(notice.is_problem ? spdlog::level::warn : spdlog::level::info, "{}", *text);
}

void Daemon::Find(Symptom symptom, const std::string& subject, std::string text, int64_t times) {
  {
    MutexLock lock(mutex_);
    state_.symptoms[static_cast<int>(symptom)] += times;
  }
  Report({.subject = fmt::format("{} {}", SymptomName(symptom), subject), .text = std::move(text)});
}

void Daemon::SaveNowAndThen(const std::stop_token& stop) {
  Mutex sleep_mutex;
  ConditionVariable sleep;
  bool is_failing = false;
  while (true) {
    std::unique_lock lock(sleep_mutex);
    sleep.wait_for(lock, stop, std::chrono::duration<double>(config_.service().save_interval_s()),
                   [] { return false; });
    if (stop.stop_requested()) return;
    const absl::Status status = Save();
    if (!status.ok()) {
      Report({.subject = "save", .text = "the map is not saved: " + ErrorText(status)});
    } else if (is_failing) {
      spdlog::info("the map is saved again");
    }
    is_failing = !status.ok();
  }
}

absl::Status Daemon::Save() {
  MutexLock file_lock(file_mutex_);
  std::shared_ptr<const MapSnapshot> map;
  std::optional<uint64_t> saved_revision;
  {
    MutexLock lock(mutex_);
    map = state_.map;
    saved_revision = state_.saved_revision;
  }
  const uint64_t revision = map->layers[own_layer_].revision;
  if (saved_revision == revision) return absl::OkStatus();
  SPLINEMAP_RETURN_IF_ERROR(file_.Save(*map));
  MutexLock lock(mutex_);
  state_.saved_revision = revision;
  return absl::OkStatus();
}

void Daemon::PublishStatus() {
  LookAround();
  bus_->Publish(config_.channel_prefix() + "_STATUS", Status());
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
  status.utime = std::chrono::duration_cast<std::chrono::microseconds>(
                     std::chrono::system_clock::now().time_since_epoch())
                     .count();
  status.version = SPLINEMAP_VERSION;
  status.uptime_s = Seconds(Clock::now() - started_);
  status.messages_queued = static_cast<int32_t>(ingest_.size());

  MutexLock lock(mutex_);
  const LayerSnapshot& layer = state_.map->layers[own_layer_];
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

absl::Status Daemon::Stop() {
  if (!receiving_.joinable()) return absl::OkStatus();
  // In the order of the data, so that each thread gets all that the one before has left.
  receiving_.request_stop();
  receiving_.join();
  commands_.reset();  // which may wait for the mapping thread
  for (std::jthread* thread : {&mapping_, &saving_}) {
    thread->request_stop();
    thread->join();
  }
  queries_.reset();
  if (const absl::Status saved = Save(); !saved.ok()) {
    const status_t status = Status();
    return Unavailable("{}; the last {} of {} commits to the map are lost", ErrorText(saved),
                       status.revision - status.saved_revision, status.revision);
  }
  server_.reset();
  {
    MutexLock lock(file_mutex_);
    SPLINEMAP_RETURN_IF_ERROR(file_.Close());
  }
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
