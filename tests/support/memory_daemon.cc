#include "tests/support/memory_daemon.h"

#include <utility>

#include "lcmtypes/splinemap/command_reply_t.hpp"
#include "lcmtypes/splinemap/command_request_t.hpp"
#include "lcmtypes/splinemap/layer_command_request_t.hpp"
#include "lcmtypes/splinemap/layers_t.hpp"
#include "lcmtypes/splinemap/points_reply_t.hpp"
#include "lcmtypes/splinemap/reply_t.hpp"
#include "lib/base/status.h"
#include "lib/replication/protocol.h"
#include "lib/rpc/messages.h"
#include "lib/wire/decode.h"

namespace splinemap {
namespace {

using std::chrono::milliseconds;

constexpr int64_t kClient = 0x1234;
constexpr milliseconds kPatience(10'000);
constexpr milliseconds kRetry(200);
constexpr milliseconds kAnswer(20);  // the call has to be heard before

}  // namespace

absl::StatusOr<std::unique_ptr<MemoryDaemon>> MemoryDaemon::Start(
    const config::Config& config, const std::vector<std::string>& channels, Handler hear) {
  std::unique_ptr<MemoryDaemon> daemon(new MemoryDaemon);
  SPLINEMAP_ASSIGN_OR_RETURN(auto bus, LcmBus::Open("memq://"));
  daemon->bus_ = bus.get();
  const std::string& prefix = config.channel_prefix();
  bus->Subscribe(ReplyChannel(prefix, kClient),
                 [d = daemon.get()](const std::string&, absl::Span<const uint8_t> message) {
                   reply_t reply;
                   if (const auto points = Decode<points_reply_t>(message); points.ok()) {
                     reply = points->header;
                   } else if (const auto done = Decode<command_reply_t>(message); done.ok()) {
                     reply = done->header;
                   } else {
                     return;
                   }
                   MutexLock lock(d->mutex_);
                   d->reply_ = reply;
                   d->heard_.notify_all();
                 });
  bus->Subscribe(prefix + "_LAYERS",
                 [d = daemon.get()](const std::string&, absl::Span<const uint8_t> message) {
                   const auto layers = Decode<layers_t>(message);
                   if (!layers.ok()) return;
                   MutexLock lock(d->mutex_);
                   d->layers_ = *layers;
                   d->heard_.notify_all();
                 });
  for (const std::string& channel : channels) {
    bus->Subscribe(prefix + channel, [hear](const std::string&, absl::Span<const uint8_t> message) {
      hear(message);
    });
  }
  SPLINEMAP_ASSIGN_OR_RETURN(daemon->daemon_, Daemon::Start(config, std::move(bus)));
  SPLINEMAP_ASSIGN_OR_RETURN(const reply_t found,
                             daemon->Ask(Rpc<PointsQuery>::kChannel, points_request_t{}));
  daemon->nonce_ = found.daemon_nonce;
  daemon->session_number_ = found.session_number;
  return daemon;
}

std::optional<layers_t> MemoryDaemon::Layers() {
  {
    MutexLock lock(mutex_);
    layers_.reset();
  }
  const auto deadline = Clock::now() + kPatience;
  while (Clock::now() < deadline) {
    Publish("SPLINEMAP_PULLS", Encode(MakeCall(kClient)));
    daemon_->PublishStatus();
    std::unique_lock lock(mutex_);
    if (heard_.wait_for(lock, kAnswer, [this] { return layers_.has_value(); })) break;
  }
  MutexLock lock(mutex_);
  return layers_;
}

template <typename Request>
absl::StatusOr<reply_t> MemoryDaemon::Ask(const std::string& channel, Request request) {
  request.header = {};
  request.header.client = kClient;
  request.header.id = ++last_id_;
  request.header.daemon_nonce = nonce_;
  const auto deadline = Clock::now() + kPatience;
  while (Clock::now() < deadline) {
    bus_->Publish("SPLINEMAP" + channel, request);
    std::unique_lock lock(mutex_);
    const bool is_there = heard_.wait_for(
        lock, kRetry, [&] { return reply_.has_value() && reply_->id == request.header.id; });
    if (is_there) return *reply_;
  }
  return absl::DeadlineExceededError("the daemon does not answer");
}

template <typename Request>
absl::Status MemoryDaemon::Command(Request request) {
  // Once more, where the layer has begun another session meanwhile.
  for (int n = 0; n < 2; ++n) {
    if constexpr (std::is_same_v<Request, command_request_t>)
      request.session_number = session_number_;
    SPLINEMAP_ASSIGN_OR_RETURN(const reply_t reply, Ask(kCommandChannel, request));
    const bool is_same_session =
        std::exchange(session_number_, reply.session_number) == reply.session_number;
    if (reply.status == 0) return absl::OkStatus();
    if (is_same_session) return StatusOf(reply);
  }
  return absl::FailedPreconditionError("the layer begins one session after the other");
}

absl::Status MemoryDaemon::Save() {
  command_request_t save{};
  save.command = "save";
  return Command(save);
}

absl::Status MemoryDaemon::Set(const std::string& command, const LayerId& id) {
  layer_command_request_t request{};
  request.command = command;
  request.name = id.name;
  request.origin = static_cast<int64_t>(id.origin);
  return Command(request);
}

}  // namespace splinemap
