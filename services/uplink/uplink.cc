#include "services/uplink/uplink.h"

#include <algorithm>
#include <random>
#include <utility>

#include "lib/base/file.h"
#include "lib/base/host_clock.h"
#include "lib/base/plain_text.h"
#include "lib/base/random.h"
#include "lib/base/status.h"
#include "lib/fleet/fleet_file.h"
#include "lib/fleet/layer_digest.h"
#include "splinemap/file.h"

namespace splinemap {
namespace {

using std::chrono::milliseconds;

constexpr std::chrono::duration<double> kRetry(1);
constexpr std::chrono::duration<double> kLongestRetry(16);
// How soon it shows that the engine has forgotten the layer, or a part of it that its digest does
// not tell of.
constexpr std::chrono::seconds kDigestInterval(10);
constexpr std::chrono::minutes kCompareInterval(5);
// Between copies of the map file: at first, when there is little in it, and then.
constexpr std::chrono::seconds kFirstFileInterval(30);
constexpr std::chrono::minutes kFileInterval(5);

absl::StatusOr<std::unique_ptr<NatsFleetStore>> ConnectPatiently(
    const FleetAddress& address, const std::function<bool()>& is_over) {
  while (true) {
    auto store = NatsFleetStore::Connect(address);
    if (store.ok() || !absl::IsUnavailable(store.status())) return store;
    for (const auto end = Clock::now() + kRetry; Clock::now() < end;) {
      if (is_over()) return store;
      std::this_thread::sleep_for(milliseconds(50));
    }
  }
}

}  // namespace

absl::StatusOr<std::unique_ptr<Uplink>> Uplink::Start(const UplinkOptions& options,
                                                      const std::function<bool()>& is_over) {
  SPLINEMAP_ASSIGN_OR_RETURN(std::unique_ptr<NatsFleetStore> store,
                             ConnectPatiently(options.fleet, is_over));
  std::unique_ptr<NatsFleetStore> files;
  if (!options.map_file.empty()) {
    SPLINEMAP_ASSIGN_OR_RETURN(files, ConnectPatiently(FilesOf(options.fleet), is_over));
  }
  std::unique_ptr<Uplink> uplink(new Uplink(options, std::move(store), std::move(files)));
  SPLINEMAP_ASSIGN_OR_RETURN(uplink->bus_,
                             LocalBus::Open(options.bus, is_over, [self = uplink.get()] {
                               MutexLock lock(self->mutex_);
                               self->is_changed_ = true;
                               self->changed_.notify_all();
                             }));
  FleetFollowOptions follow;
  follow.names = options.bus.others;
  follow.but = uplink->bus_->robot();
  follow.region = options.region;
  if (follow.names.empty()) follow.names = {""};  // nobody's; settings alone
  uplink->replica_ = std::make_unique<FleetReplica>(
      *uplink->store_, follow, [bus = uplink->bus_.get()](const FleetReplica& replica) {
        bus->UseFleet(replica.WholeLayers());
      });
  uplink->uploading_ =
      std::jthread([self = uplink.get()](const std::stop_token& stop) { self->Run(stop); });
  return uplink;
}

Uplink::Uplink(UplinkOptions options, std::unique_ptr<NatsFleetStore> store,
               std::unique_ptr<NatsFleetStore> files)
    : options_(std::move(options)),
      store_(std::move(store)),
      files_(std::move(files)),
      pace_(options_.max_kb_per_s * 1000),
      file_pause_(kFirstFileInterval) {}

Uplink::~Uplink() {
  uploading_ = {};
  if (!file_copy_.empty()) MapFile::Remove(file_copy_);
  replica_.reset();
  bus_.reset();
}

Uplink::State Uplink::state() const {
  State state;
  {
    MutexLock lock(mutex_);
    state = state_;
    if (state.problem.empty()) state.problem = file_problem_;
  }
  if (std::string problem = bus_->Problem(); !problem.empty()) state.problem = problem;
  if (state.problem.empty()) state.problem = store_->Problem();
  if (state.problem.empty()) state.problem = replica_->Problem();
  state.layers_of_others = replica_->FollowedLayers().size();
  state.bytes_received = replica_->BytesReceived();
  return state;
}

bool Uplink::Wait(const std::stop_token& stop, Clock::time_point until) {
  std::unique_lock lock(mutex_);
  changed_.wait_until(lock, stop, until, [] { return false; });
  return !stop.stop_requested();
}

void Uplink::Run(const std::stop_token& stop) {
  std::mt19937_64 random(RandomId());
  next_compare_ = Clock::now() + kCompareInterval;
  std::chrono::duration<double> pause = kRetry;
  while (!stop.stop_requested()) {
    const Clock::time_point begin = Clock::now();
    const absl::Status status = BringOwn(stop);
    {
      MutexLock lock(mutex_);
      state_.problem = absl::IsCancelled(status) ? "" : ErrorText(status);
    }
    if (status.ok()) {
      pause = kRetry;
      BringFile(stop, begin + options_.interval);
      Wait(stop, begin + options_.interval);
    } else {
      // Not all robots at once, when servers come back.
      Wait(stop, begin + std::chrono::duration_cast<Clock::duration>(
                             pause * std::uniform_real_distribution(0.5, 1.5)(random)));
      pause = std::min(2 * pause, kLongestRetry);
    }
    // Without changes until it is time to look.
    std::unique_lock lock(mutex_);
    if (status.ok()) {
      changed_.wait_until(lock, stop, next_look_, [this] { return is_changed_; });
    }
    is_changed_ = false;
  }
}

// In the time that the layer leaves. A copy is made now and then, and goes as far as there is time.
void Uplink::BringFile(const std::stop_token& stop, Clock::time_point until) {
  const Clock::time_point now = Clock::now();
  if (!files_ || (file_copy_.empty() && now < next_file_)) return;
  const std::optional<LayerSnapshot> own = bus_->OwnLayer();
  if (!own) return;
  absl::Status status;
  if (file_copy_.empty()) {
    std::string copy = TemporaryPathFor(options_.map_file);
    status = MapFile::Copy(options_.map_file, copy);
    if (status.ok()) {
      file_copy_ = std::move(copy);
      file_upload_.emplace(*files_, own->id, file_copy_, HostUtime());
    }
  }
  if (status.ok()) {
    status = file_upload_->Bring([&](int64_t bytes) {
      {
        MutexLock lock(mutex_);
        if (is_changed_ && Clock::now() >= until) return false;
      }
      return Wait(stop, pace_.Take(bytes, Clock::now()));
    });
  }
  if (absl::IsCancelled(status)) return;  // it goes on where it was
  const bool goes_on = absl::IsUnavailable(status) && !file_copy_.empty();
  if (!goes_on) {
    file_upload_.reset();
    if (!file_copy_.empty()) MapFile::Remove(std::exchange(file_copy_, ""));
    next_file_ = Clock::now() + file_pause_;
    if (status.ok()) file_pause_ = std::min<Clock::duration>(2 * file_pause_, kFileInterval);
  }
  MutexLock lock(mutex_);
  if (status.ok()) ++state_.files;
  file_problem_ = status.ok() ? "" : "the map file: " + ErrorText(status);
}

absl::Status Uplink::CheckMap() {
  const std::optional<MapOptions> map = replica_->map_options();
  if (!map) {
    return Unavailable(
        "the fleet's map '{}' says nothing of its knot interval yet; is splinemap-fleet-worker "
        "running?",
        options_.fleet.map);
  }
  if (*map == bus_->map_options()) return absl::OkStatus();
  return FailedPrecondition(
      "the robot's map has {}, the fleet's has {}: they cannot be added. Give the daemon the "
      "fleet's, and a new map file",
      TextOf(bus_->map_options()), TextOf(*map));
}

absl::Status Uplink::BringOwn(const std::stop_token& stop) {
  SPLINEMAP_RETURN_IF_ERROR(CheckMap());
  const std::optional<LayerSnapshot> own = bus_->OwnLayer();
  if (!own) {
    return Unavailable("nothing of {} is complete yet on its bus", PlainText(bus_->robot()));
  }
  const LayerSettings settings = replica_->Layers().settings.Of(own->id);
  if (settings.IsRemoved(own->session)) {
    return FailedPrecondition(
        "session {} of {} was removed from the fleet; the daemon is told, and begins an empty one",
        own->session.number, PlainText(own->id.name));
  }
  LayerUpload& upload =
      uploads_.try_emplace(own->id, *store_, own->id, bus_->map_options()).first->second;
  const Clock::time_point now = Clock::now();
  if (now >= next_look_) {
    SPLINEMAP_RETURN_IF_ERROR(upload.Look());
    next_look_ = now + kDigestInterval;
  }
  if (now >= next_compare_) {
    upload.CompareAgain();
    next_compare_ = now + kCompareInterval;
  }
  const absl::Status brought = upload.Bring(
      *own, [&](int64_t bytes) { return Wait(stop, pace_.Take(bytes, Clock::now())); });
  {
    MutexLock lock(mutex_);
    state_.layer = own->id;
    state_.revision_here = own->revision;
    if (brought.ok()) state_.revision_there = own->revision;
    state_.sent = upload.counts();
  }
  if (!absl::IsFailedPrecondition(brought)) return brought;
  const SessionId greater = *upload.greater_session();
  if (upload.counts().digests == 0) {
    bus_->TellLaterSession(own->id, greater);
    return FailedPrecondition(
        "the fleet knows a later session of {} ({} by {:016x}) than that of the daemon ({} by "
        "{:016x}): its map file is an older copy. The daemon is told, and begins a later one",
        PlainText(own->id.name), greater.number, greater.nonce, own->session.number,
        own->session.nonce);
  }
  return FailedPrecondition(
      "layer {}@{:016x} is also written in session {} by {:016x}, later than that of the daemon "
      "here. "
      "If that does not end in a minute, two robots have copies of one map file: start one of them "
      "with a new one",
      PlainText(own->id.name), own->id.origin, greater.number, greater.nonce);
}

}  // namespace splinemap
