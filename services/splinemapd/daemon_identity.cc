#include <algorithm>
#include <utility>

#include "absl/strings/escaping.h"
#include "lib/base/random.h"
#include "lib/base/status.h"
#include "lib/wire/decode.h"
#include "services/splinemapd/daemon.h"

// The identity of the daemon's own layer, and what clients command.

namespace splinemap {
namespace {

// How often the identity of the layer is looked at, and how soon tried again where it fails.
constexpr std::chrono::milliseconds kIdentityInterval(500);

}  // namespace

LayerLife Daemon::OwnLife() {
  MutexLock lock(mutex_);
  const LayerSnapshot& layer = state_.map->layers.front();
  return {layer.id, layer.epoch, {}};
}

// Followers take the later of two lives of a layer for the layer.
void Daemon::LookAtDigest(absl::Span<const uint8_t> message) {
  const LayerLife own = OwnLife();
  const absl::StatusOr<layer_digest_t> digest = DecodeLayerDigest(message);
  if (!digest.ok()) return;
  const LayerLife heard = FromMessage(digest->layer);
  if (heard.id == own.id && heard.epoch == own.epoch) return;
  {
    MutexLock lock(mutex_);
    if (heard == former_life_) return;
  }
  if (heard.id.name == own.id.name && heard.id != own.id) FindNamesakes(own.id, heard.id);
  if (heard.id != own.id) return;
  if (heard.epoch < own.epoch) {
    Find(Symptom::kSharedIdentity, "earlier",
         fmt::format("an earlier start of {} is on the bus: a replayed log, or a splinemapd with a "
                     "copy of this map file; followers ignore it",
                     own.id.name));
    return;
  }
  MutexLock lock(mutex_);
  identity_.TakeDigest(heard, own, Clock::now());
}

void Daemon::FindNamesakes(const LayerId& first, const LayerId& second) {
  constexpr size_t kMaxNoticed = 256;
  {
    MutexLock lock(mutex_);
    if (noticed_namesakes_.size() >= kMaxNoticed || !noticed_namesakes_.insert(second).second) {
      return;
    }
  }
  Find(Symptom::kSharedName, first.name,
       fmt::format("there are two layers of {}, of the origins {:016x} and {:016x}: two robots of "
                   "that name, or a map from before a file was begun. Who follows {} sums both; "
                   "splinemap layers shows them, splinemap control mutes or removes one",
                   first.name, first.origin, second.origin, first.name));
}

// Somebody keeps this layer, since its owner was away, and may have it in a later life.
void Daemon::LookAtStandIn(absl::Span<const uint8_t> message) {
  const auto stand_in = DecodeStandInDigest(message);
  if (!stand_in.ok()) return;
  const LayerLife own = OwnLife();
  MutexLock lock(mutex_);
  identity_.TakePull(FromMessage(stand_in->digest.layer), own, Clock::now());
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
  if (const absl::Status removed = ObeyRemoval(); !removed.ok()) {
    Report({.subject = "removed",
            .text = "somebody removed this layer, and no empty one can be saved: " +
                    ErrorText(removed)});
  }
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
  MapSnapshot map = *sum_->Snapshot();
  map.own_layer = life.id;
  LayerSnapshot& own = map.layers.front();
  own = map_->Snapshot()->layers.front();
  own.id = life.id;
  own.epoch = life.epoch;
  if (is_empty) {
    own.tiles = {};
    ++own.revision;
  }
  SPLINEMAP_RETURN_IF_ERROR(SaveFile(map));
  {
    const LayerLife former = OwnLife();
    MutexLock state_lock(mutex_);
    former_life_ = former;
  }
  if (is_empty) {
    map_->layer(0).BeginEmptyLife(life.epoch);
  } else {
    map_->layer(0).BeginLife(life.id, life.epoch);
  }
  ShowState();
  keeper_->SetOwnLayer(life.id, life.epoch.incarnation);
  return absl::OkStatus();
}

absl::Status Daemon::Do(const CommandServer::Request& request) {
  if (const auto* of_layer = std::get_if<layer_command_request_t>(&request)) {
    return DecideAboutLayer(*of_layer);
  }
  const std::string& command = std::get<command_request_t>(request).command;
  const auto start = static_cast<uint64_t>(std::get<command_request_t>(request).incarnation);
  SPLINEMAP_RETURN_IF_ERROR(CheckIncarnation(start));
  if (command == "save") return Save();
  if (command != "clear") {
    return InvalidArgument("no such command: {}; there are save and clear",
                           absl::Utf8SafeCHexEscape(command.substr(0, 20)));
  }
  return DoWhereMapped([this, start]() -> absl::Status {
    SPLINEMAP_RETURN_IF_ERROR(CheckIncarnation(start));
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

absl::Status Daemon::DecideAboutLayer(const layer_command_request_t& request) {
  const LayerId id{request.name, static_cast<uint64_t>(request.origin)};
  const auto map = sum_->Snapshot();
  const auto layer = std::find_if(map->layers.begin(), map->layers.end(),
                                  [&](const LayerSnapshot& other) { return other.id == id; });
  if (layer == map->layers.end()) {
    return absl::NotFoundError(
        fmt::format("{} has no layer {} of origin {:016x}", OwnLife().id.name,
                    absl::Utf8SafeCHexEscape(id.name.substr(0, 64)), id.origin));
  }
  const std::string& command = request.command;
  LayerControl control = map->controls.Next(id, daemon_nonce_);
  if (command == "mute" || command == "unmute") {
    control.muted = command == "mute";
  } else if (command == "yield" || command == "insist") {
    control.yields = command == "yield";
  } else if (command == "shift") {
    control.shift = {request.shift_i, request.shift_j};
  } else if (command == "remove") {
    if (static_cast<uint64_t>(request.incarnation) != layer->epoch.incarnation) {
      return FailedPrecondition("the command is for start {} of layer {}, which is in start {}",
                                request.incarnation, id.name, layer->epoch.incarnation);
    }
    control = map->controls.Removal(id, layer->epoch.incarnation, daemon_nonce_);
  } else {
    return InvalidArgument(
        "no such command: {}; there are mute, unmute, yield, insist, shift and remove",
        absl::Utf8SafeCHexEscape(command.substr(0, 20)));
  }
  if (!control.IsValid()) {
    return InvalidArgument("a shift by ({}, {}) knots; {} each way is the most", request.shift_i,
                           request.shift_j, KnotShift::kMax);
  }
  keeper_->Decide(id, control);
  if (!keeper_->Controls().records().contains(id)) {
    return absl::ResourceExhaustedError(
        fmt::format("{} layers have decisions already, which is the most", LayerControls::kMax));
  }
  Report({.is_problem = false,
          .subject = fmt::format("layers {} {}", command, id.name),
          .text = fmt::format("a client decided: {} layer {}", command, id.name)});
  SPLINEMAP_RETURN_IF_ERROR(DoWhereMapped([this] { return ObeyRemoval(); }));
  return Save();
}

// Whoever removed the layer, this daemon's map goes on without what there was.
absl::Status Daemon::ObeyRemoval() {
  LayerLife life = OwnLife();
  const LayerControl control = keeper_->Controls().Of(life.id);
  // A file may have a removal from when commands were allowed.
  if (!control.IsRemoved(life.epoch) || !config_.service().remote_commands()) {
    return absl::OkStatus();
  }
  life.epoch = {control.removed_up_to + 1, RandomId()};
  SPLINEMAP_RETURN_IF_ERROR(BeginLife(life, /*is_empty=*/true));
  Report({.subject = "removed",
          .text = fmt::format("somebody removed the layer {}; it goes on empty, as start {}",
                              life.id.name, life.epoch.incarnation)});
  return absl::OkStatus();
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

}  // namespace splinemap
