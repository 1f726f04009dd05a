#include "services/uplink/local_bus.h"

#include <algorithm>
#include <chrono>
#include <utility>

#include "lib/base/plain_text.h"
#include "lib/base/random.h"
#include "lib/base/status.h"
#include "lib/replication/admission.h"
#include "lib/wire/encode.h"

namespace splinemap {
namespace {

using std::chrono::milliseconds;

constexpr milliseconds kLongestWait(200);
constexpr milliseconds kShortestTick(2);
constexpr milliseconds kDrain(10);
// For a new state of the own layer; there is one for each digest.
constexpr milliseconds kLookInterval(100);
constexpr milliseconds kFleetInterval(1000);
// A daemon that hears of it so often, for five seconds, begins a later session.
constexpr milliseconds kTellInterval(1000);

struct Owner {
  std::string robot;
  MapOptions options;
};

// Of the robot, or, without a name, of whoever speaks first.
absl::StatusOr<Owner> FindOwner(LcmBus& bus, const LocalBusOptions& options,
                                const std::function<bool()>& is_over) {
  std::optional<Owner> owner;
  Admission admission(options.channel_prefix, options.keys, RandomId());
  const std::string channel = options.channel_prefix + kDigestChannel;
  bus.Subscribe(channel, [&](const std::string&, absl::Span<const uint8_t> bytes) {
    const auto message = admission.Admit(bytes);
    const auto* digest = message ? std::get_if<layer_digest_t>(&message->content) : nullptr;
    if (owner || digest == nullptr || !IsOwners(*digest) ||
        digest->protocol_version != kProtocolVersion) {
      return;
    }
    if (!options.robot.empty() && digest->layer.name != options.robot) return;
    owner = {digest->layer.name,
             {digest->knot_interval_m,
              {static_cast<ControlPoint>(digest->min_control_point),
               static_cast<ControlPoint>(digest->max_control_point)}}};
  });
  const std::string pulls = ChannelOf(layer_pull_t(), options.channel_prefix);
  const uint64_t speaker = RandomId();
  Clock::time_point next_call;
  while (!owner) {
    if (is_over()) return absl::CancelledError("the uplink was ended");
    if (Clock::now() >= next_call) {
      next_call = Clock::now() + std::chrono::seconds(1);
      bus.PublishBytes(pulls, Signed(options.keys.get(), pulls, Encode(MakeCall(speaker))));
    }
    bus.Handle(kLongestWait);
  }
  return *owner;
}

}  // namespace

absl::StatusOr<std::unique_ptr<LocalBus>> LocalBus::Open(const LocalBusOptions& options,
                                                         const std::function<bool()>& is_over,
                                                         std::function<void()> on_change) {
  LocalBusOptions found = options;
  MapOptions map_options;
  {
    SPLINEMAP_ASSIGN_OR_RETURN(const std::unique_ptr<LcmBus> bus, LcmBus::Open(options.lcm_url));
    SPLINEMAP_ASSIGN_OR_RETURN(const Owner owner, FindOwner(*bus, options, is_over));
    found.robot = owner.robot;
    map_options = owner.options;
  }
  SPLINEMAP_ASSIGN_OR_RETURN(std::unique_ptr<LcmBus> bus, LcmBus::Open(options.lcm_url));
  return std::unique_ptr<LocalBus>(
      new LocalBus(std::move(found), std::move(bus), map_options, std::move(on_change)));
}

namespace {

FollowOptions FollowOptionsOf(const LocalBusOptions& options) {
  FollowOptions follow;
  follow.channel_prefix = options.channel_prefix;
  follow.keys = options.keys;
  follow.names = options.others;
  follow.names.push_back(options.robot);
  return follow;
}

}  // namespace

LocalBus::LocalBus(LocalBusOptions options, std::unique_ptr<LcmBus> bus,
                   const MapOptions& map_options, std::function<void()> on_change)
    : options_(std::move(options)),
      bus_(std::move(bus)),
      map_options_(map_options),
      on_change_(std::move(on_change)),
      speaker_(RandomId()),
      follower_(FollowOptionsOf(options_), KeeperOptions{map_options, {}, 0}, LayerSet(), speaker_,
                Clock::now()),
      budget_(PublisherOptions().bytes_per_s),
      following_([this](const std::stop_token& stop) { Run(stop); }) {}

LocalBus::~LocalBus() {
  following_.request_stop();
  bus_->Wake();
  following_.join();
}

std::optional<LayerSnapshot> LocalBus::OwnLayer() const {
  MutexLock lock(mutex_);
  return own_;
}

void LocalBus::UseFleet(const LayerSet& fleet) {
  {
    MutexLock lock(mutex_);
    fleet_ = fleet;
    next_fleet_ = {};
  }
  bus_->Wake();
}

void LocalBus::TellLaterSession(const LayerId& id, const SessionId& session) {
  MutexLock lock(mutex_);
  const LayerRef ref{id, session, {}};
  if (!later_session_ || later_session_->ref != ref) later_session_ = {ref, Clock::now()};
}

std::string LocalBus::Problem() const {
  if (std::string problem = bus_->Problem(); !problem.empty()) return problem;
  MutexLock lock(mutex_);
  const std::vector<std::string> refused = follower_.refused();
  return refused.empty() ? "" : "not followed: " + PlainText(refused.front());
}

void LocalBus::Run(const std::stop_token& stop) {
  for (const std::string& channel : ReplicationChannels(options_.channel_prefix)) {
    bus_->Subscribe(channel, [&](const std::string&, absl::Span<const uint8_t> message) {
      MutexLock lock(mutex_);
      follower_.HandleBytes(message, Clock::now());
    });
  }
  Clock::time_point next_tick;
  while (!stop.stop_requested()) {
    const auto wait = std::chrono::ceil<milliseconds>(next_tick - Clock::now());
    bus_->Handle(std::clamp(wait, milliseconds(0), kLongestWait));
    const Clock::time_point drain_end = Clock::now() + kDrain;
    while (Clock::now() < drain_end && bus_->Handle(milliseconds(0)) == LcmBus::Handled::kMessage) {
    }
    const Clock::time_point now = Clock::now();
    const std::vector<ReplicationMessage> messages = Tick(now);
    {
      MutexLock lock(mutex_);
      next_tick = std::max(follower_.NextTick(now), now + kShortestTick);
    }
    for (const ReplicationMessage& message : messages) {
      const std::string channel = ChannelOf(message, options_.channel_prefix);
      bus_->PublishBytes(channel, Signed(options_.keys.get(), channel, EncodeReplication(message)));
    }
  }
}

std::vector<ReplicationMessage> LocalBus::Tick(Clock::time_point now) {
  bool is_changed = false;
  std::vector<ReplicationMessage> messages;
  {
    MutexLock lock(mutex_);
    budget_.Refill(now, /*has_changes=*/false, follower_.HasPulls());
    messages = follower_.Tick(now, budget_);
    if (now >= next_fleet_) {
      next_fleet_ = now + kFleetInterval;
      TakeFromFleet(now);
    }
    if (now >= next_look_) {
      next_look_ = now + kLookInterval;
      const uint64_t before = own_ ? own_->tiles.version() : 0;
      FindOwnLayer();
      is_changed = own_ && own_->tiles.version() != before;
    }
    if (later_session_ && own_ && own_->id == later_session_->ref.id &&
        own_->session >= later_session_->ref.session) {
      later_session_.reset();
    }
    if (later_session_ && now >= later_session_->next) {
      later_session_->next = now + kTellInterval;
      layer_pull_t pull{};
      pull.speaker = static_cast<int64_t>(speaker_);
      pull.layer = ToMessage(later_session_->ref);
      messages.emplace_back(std::move(pull));
    }
  }
  if (is_changed) on_change_();
  return messages;
}

// Layers of robots that are heard here are refused, and taken when these have gone.
void LocalBus::TakeFromFleet(Clock::time_point now) {
  for (const auto& [id, settings] : fleet_.settings.records()) {
    // Of layers that are not here, daemons keep a few.
    if (id.name != options_.robot && fleet_.Find(id) == nullptr) continue;
    const LayerSettings known = follower_.settings().Of(id);
    const LayerSettings merged = Merge(known, settings);
    if (merged != known) follower_.Set(id, merged);
  }
  if (fleet_.options != map_options_) return;
  for (const LayerSnapshot& layer : fleet_.layers) {
    if (layer.id.name == options_.robot) continue;
    const State state{layer.session, layer.tiles.version()};
    const auto adopted = adopted_.find(layer.id);
    if (adopted != adopted_.end() && adopted->second == state) continue;
    if (follower_.Adopt(layer, now)) adopted_[layer.id] = state;
  }
  std::erase_if(adopted_, [&](const auto& entry) { return fleet_.Find(entry.first) == nullptr; });
}

// Of several layers of the robot, that of the daemon which was heard last.
void LocalBus::FindOwnLayer() {
  double least_s = 0;
  std::optional<LayerId> newest;
  for (const FollowedLayer& layer : follower_.FollowedLayers(Clock::now())) {
    if (layer.id.name != options_.robot || layer.heard_s_ago < 0) continue;
    if (newest && layer.heard_s_ago >= least_s) continue;
    least_s = layer.heard_s_ago;
    newest = layer.id;
  }
  if (!newest) return;
  const LayerSet synced = follower_.SyncedLayers();
  if (const LayerSnapshot* own = synced.Find(*newest)) own_ = *own;
}

}  // namespace splinemap
