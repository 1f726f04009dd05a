#include "services/splinemapd/daemon.h"

#include <spdlog/spdlog.h>

#include <algorithm>
#include <filesystem>
#include <utility>

#include "lib/base/random.h"
#include "lib/base/status.h"
#include "lib/replication/channels.h"

namespace splinemap {
namespace {

using std::chrono::milliseconds;

// How soon threads notice that they are to end.
constexpr milliseconds kPatience(50);
// How old at most what others see of the map is, while messages pour in.
constexpr milliseconds kShowInterval(20);
// Messages that are still under way when the daemon ends are received for at most this long.
constexpr milliseconds kMaxDrain(2000);

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

// The layer that this daemon went on with last; of a file that was built or merged, the one of its
// name. Others of its name are of others.
std::vector<LayerSnapshot>::iterator OwnLayerOf(MapSnapshot& map, const std::string& name) {
  return std::find_if(map.layers.begin(), map.layers.end(), [&](const LayerSnapshot& layer) {
    return layer.id.name == name && (!map.own_layer || layer.id == *map.own_layer);
  });
}

// Beyond half of what may be said somebody else has counted, and may go on.
bool HasRoomToCount(uint64_t incarnation, uint64_t revision) {
  return incarnation <= LayerEpoch::kMaxIncarnation / 2 && revision <= kMaxRevision / 2;
}

void Renumber(const TileTree& tiles, Layer& layer) {
  tiles.ForEach(
      [&](TileKey key, const TileTree::Entry& entry) { layer.RestoreTile(key, entry.tile, 1); });
}

}  // namespace

absl::StatusOr<std::unique_ptr<Daemon>> Daemon::Start(const config::Config& config,
                                                      std::unique_ptr<LcmBus> bus) {
  SPLINEMAP_RETURN_IF_ERROR(CheckConfig(config));
  SPLINEMAP_ASSIGN_OR_RETURN(MapFile file, MapFile::Open(MapPath(config)));
  std::unique_ptr<Daemon> daemon(new Daemon(config, std::move(bus), std::move(file)));
  SPLINEMAP_ASSIGN_OR_RETURN(const MapSnapshot kept, daemon->OpenMap());
  daemon->Serve(kept);
  daemon->saving_ =
      std::jthread([d = daemon.get()](const std::stop_token& s) { d->SaveNowAndThen(s); });
  daemon->mapping_ =
      std::jthread([d = daemon.get()](const std::stop_token& s) { d->MapMessages(s); });
  daemon->receiving_ =
      std::jthread([d = daemon.get()](const std::stop_token& s) { d->Receive(s); });
  return daemon;
}

void Daemon::Serve(const MapSnapshot& kept) {
  using Duration = std::chrono::duration<double, std::milli>;
  const config::Service& service = config_.service();
  const std::string& prefix = config_.channel_prefix();
  PublisherOptions options;
  options.bytes_per_s = service.max_publish_kb_per_s() * 1000;
  options.push_interval =
      std::chrono::duration_cast<milliseconds>(Duration(service.push_interval_ms()));
  const uint64_t nonce = RandomId();
  for (const char* followed : kFollowedChannels) {
    bus_->Subscribe(prefix + followed,
                    [this](const std::string& channel, absl::Span<const uint8_t> message) {
                      if (channel.ends_with(kDigestChannel)) LookAtDigest(message);
                      if (channel.ends_with(kStandInChannel)) LookAtStandIn(message);
                      if (channel.ends_with(kPullChannel)) {
                        LookAtPull(message);
                        server_->TakePull(message);
                      }
                      keeper_->Take(message);
                    });
  }
  for (const std::string& channel : QueryServer::Channels(prefix)) {
    bus_->Subscribe(channel, [this](const std::string&, absl::Span<const uint8_t> message) {
      queries_->TakeRequest(message);
    });
  }
  bus_->Subscribe(prefix + kCommandChannel,
                  [this](const std::string&, absl::Span<const uint8_t> message) {
                    commands_->TakeRequest(message);
                  });
  server_ = std::make_unique<LayerServer>(*bus_, prefix, options, [this] {
    MutexLock lock(mutex_);
    return state_.map;
  });
  FollowOptions follow;
  follow.channel_prefix = prefix;
  follow.names = {service.follow().begin(), service.follow().end()};
  // A log of everything, replayed to a robot's daemon, must not count twice.
  if (follow.names.empty() && service.sensors()) follow.names = {""};
  follow.max_tiles = (size_t{service.max_followed_mb()} << 20) / sizeof(Tile);
  follow.takes_decisions = service.remote_commands();
  keeper_ = std::make_unique<LayerKeeper>(
      *bus_, follow,
      Keeper{map_->options(), OwnLife().id, nonce, options, OwnLife().epoch.incarnation}, kept,
      *sum_);
  const Replier replier{
      .channel_prefix = prefix,
      .daemon_nonce = nonce,
      .take_snapshot = [this] { return sum_->Snapshot(); },
      .send = [this](const std::string& channel,
                     absl::Span<const uint8_t> reply) { bus_->PublishBytes(channel, reply); }};
  daemon_nonce_ = nonce;
  queries_ = std::make_unique<QueryServer>(replier);
  commands_ = std::make_unique<CommandServer>(
      replier, service.remote_commands(),
      [this](const CommandServer::Request& request) { return Do(request); });
}

Daemon::Daemon(const config::Config& config, std::unique_ptr<LcmBus> bus, MapFile file)
    : config_(config),
      bus_(std::move(bus)),
      ingest_(size_t{config.service().max_queued_mb()} << 20),
      file_(std::move(file)) {}

Daemon::~Daemon() {
  if (absl::Status status = Stop(); !status.ok()) spdlog::error("{}", ErrorText(status));
}

absl::StatusOr<MapSnapshot> Daemon::OpenMap() {
  SPLINEMAP_ASSIGN_OR_RETURN(MapSnapshot kept, LoadMap(RobotName(config_)));
  // The layer is the mapper's from here on; everybody else sees snapshots.
  Layer& layer = map_->layer(0);
  mapper_ = std::make_unique<Mapper>(config_, map_->options(), layer);
  spdlog::info("map {}: layer {}, start {}, {} tiles", MapPath(config_), layer.id().name,
               layer.epoch().incarnation, layer.tiles().size());
  if (!kept.layers.empty()) {
    spdlog::info("map {}: {} layers of others", MapPath(config_), kept.layers.size());
  }
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
  sum_->SetFollowed(kept.layers, kept.controls);
  ShowState();
  SPLINEMAP_RETURN_IF_ERROR(Save());  // the new incarnation
  return kept;
}

absl::StatusOr<MapSnapshot> Daemon::LoadMap(const std::string& name) {
  MutexLock lock(file_mutex_);
  MapSnapshot map;
  map.options = MapOptionsOf(config_.method());
  if (const absl::StatusOr<LoadedMap> loaded = file_.Load(); !absl::IsNotFound(loaded.status())) {
    SPLINEMAP_RETURN_IF_ERROR(loaded.status());
    ReportDamages(*loaded);
    map = *loaded->map;
    SPLINEMAP_RETURN_IF_ERROR(CheckMethod(config_.method(), map.options, MapPath(config_)));
    config_.mutable_method()->set_knot_interval_m(map.options.knot_interval_m);
    SPLINEMAP_RETURN_IF_ERROR(CheckConfig(config_));
  }
  map_ = std::make_unique<Map>(map.options);
  sum_ = std::make_unique<SummedMap>(map.options);
  const auto own = OwnLayerOf(map, name);
  if (own == map.layers.end()) {
    map_->AddLayer({name, RandomId()}, {1, RandomId()});
    return map;
  }
  // A start takes the next incarnation, so that nothing of an earlier life is taken for new.
  const LayerEpoch epoch{own->epoch.incarnation + 1, RandomId()};
  const LayerControl& control = map.controls.Of(own->id);
  const bool is_removed = control.IsRemoved(epoch) && config_.service().remote_commands();
  const uint64_t incarnation = is_removed ? control.removed_up_to + 1 : epoch.incarnation;
  if (HasRoomToCount(incarnation, own->revision)) {
    if (is_removed) {
      map_->AddLayer(own->id, {incarnation, epoch.nonce});
    } else {
      map_->ContinueLayer(*own, epoch);
    }
  } else {
    Layer& fresh = map_->AddLayer({name, RandomId()}, {1, epoch.nonce});
    if (!is_removed) Renumber(own->tiles, fresh);
    Report(
        {.subject = "identity",
         .text = fmt::format("start {} and commit {} of {} leave no room to count on, so that "
                             "it goes on as another layer, origin {:016x}; who has that of "
                             "origin {:016x}, too, sums both: splinemap control removes it",
                             incarnation, own->revision, name, fresh.id().origin, own->id.origin)});
  }
  map.layers.erase(own);
  return map;
}

void Daemon::ReportDamages(const LoadedMap& loaded) {
  const std::vector<std::string>& damages = loaded.damages;
  if (damages.empty()) return;
  constexpr size_t kMaxLines = 5;
  std::string text =
      fmt::format("{}: {} damages, of which the next save leaves nothing; the file is kept as {}",
                  MapPath(config_), damages.size(), loaded.kept_copy);
  for (size_t k = 0; k < std::min(damages.size(), kMaxLines); ++k) text += "; " + damages[k];
  Report({.subject = "damage", .text = std::move(text)});
}

void Daemon::Receive(const std::stop_token& stop) {
  while (!stop.stop_requested()) {
    bus_->Handle(kPatience);
    const std::optional<std::string> news = bus_->TakeNews();
    if (!news) continue;
    const bool is_away = !bus_->Problem().empty();
    {
      MutexLock lock(mutex_);
      limiter_.Forget("bus");
      if (is_away) ++state_.symptoms[static_cast<int>(Symptom::kBusAway)];
    }
    Report({.is_problem = is_away, .subject = "bus", .text = *news});
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
  const Layer& layer = map_->layer(0);
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
  sum_->SetOwn(snapshot->layers.front());
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

void Daemon::SaveNow() {
  if (const absl::Status status = Save(); !status.ok()) {
    Report({.subject = "save", .text = "the map is not saved: " + ErrorText(status)});
  } else {
    spdlog::info("the map is saved");
  }
}

absl::Status Daemon::SaveFile(const MapSnapshot& map) {
  const absl::StatusOr<std::vector<std::string>> problems = file_.Save(map);
  if (!problems.ok() && !file_.IsThere()) return SaveElsewhere(map, problems.status());
  SPLINEMAP_RETURN_IF_ERROR(problems.status());
  if (problems->empty()) return absl::OkStatus();
  Report({.subject = "left out",
          .text = fmt::format(
              "saved to {}, but: {}{}", MapPath(config_), problems->front(),
              problems->size() == 1 ? "" : fmt::format("; and {} more", problems->size() - 1))});
  return absl::OkStatus();
}

// Where it was, where nothing stands there now; else beside it; else in the temporary folder.
absl::Status Daemon::SaveElsewhere(const MapSnapshot& map, const absl::Status& why) {
  const std::filesystem::path path = MapPath(config_);
  const std::string rescue =
      fmt::format("{}.rescue-{:08x}.splinemap", path.stem().string(), RandomId() & 0xffffffff);
  std::vector<std::filesystem::path> places{path, path.parent_path() / rescue};
  std::error_code error;
  const std::filesystem::path temporary = std::filesystem::temp_directory_path(error);
  if (!error) places.push_back(temporary / rescue);
  for (const std::filesystem::path& place : places) {
    if (!file_.SaveElsewhere(place.string(), map).ok()) continue;
    Report(
        {.subject = "rescue",
         .text = fmt::format("{}; the map is in {} from now on", ErrorText(why), place.string())});
    return absl::OkStatus();
  }
  return why;
}

absl::Status Daemon::Save() {
  MutexLock file_lock(file_mutex_);
  const std::shared_ptr<const MapSnapshot> map = sum_->Snapshot();
  if (saved_.lock() == map && file_.IsThere()) return absl::OkStatus();
  if (const absl::Status saved = SaveFile(*map); !saved.ok()) {
    MutexLock lock(mutex_);
    if (!file_.IsThere()) state_.saved_revision.reset();
    return saved;
  }
  saved_ = map;
  MutexLock lock(mutex_);
  state_.saved_revision = map->layers.front().revision;
  return absl::OkStatus();
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
  keeper_.reset();
  absl::Status saved = Save();
  if (!saved.ok()) {
    MutexLock lock(file_mutex_);
    saved = SaveElsewhere(*sum_->Snapshot(), saved);
  }
  if (!saved.ok()) {
    const status_t status = Status();
    return Unavailable("{}; the last {} of {} commits to the map are lost", ErrorText(saved),
                       status.revision - status.saved_revision, status.revision);
  }
  server_.reset();
  {
    MutexLock lock(file_mutex_);
    SPLINEMAP_RETURN_IF_ERROR(file_.Close());
    if (file_.path() != MapPath(config_)) {
      return Unavailable("{} could not be written; the map is in {}, with all commits",
                         MapPath(config_), file_.path());
    }
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
