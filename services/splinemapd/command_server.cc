#include "services/splinemapd/command_server.h"

#include <algorithm>

#include "lib/base/status.h"
#include "lib/wire/decode.h"
#include "lib/wire/encode.h"

namespace splinemap {
namespace {

constexpr size_t kMaxWaiting = 16;
constexpr size_t kMaxRemembered = 64;

const request_t& HeadOf(const CommandServer::Request& request) {
  return std::visit([](const auto& r) -> const request_t& { return r.head; }, request);
}

absl::StatusOr<CommandServer::Request> Decode(absl::Span<const uint8_t> message) {
  if (TypeOf(message) == MessageType::kLayerCommandRequest) {
    SPLINEMAP_ASSIGN_OR_RETURN(auto request, DecodeRpc<layer_command_request_t>(message));
    return request;
  }
  SPLINEMAP_ASSIGN_OR_RETURN(auto request, DecodeRpc<command_request_t>(message));
  return request;
}

}  // namespace

CommandServer::CommandServer(Replier replier, bool allowed, Do do_command)
    : replier_(std::move(replier)),
      allowed_(allowed),
      do_(std::move(do_command)),
      serving_([this](const std::stop_token& stop) { Serve(stop); }) {}

void CommandServer::TakeRequest(absl::Span<const uint8_t> message) {
  absl::StatusOr<Request> request = Decode(message);
  if (!request.ok()) return;
  const request_t& head = HeadOf(*request);
  if (replier_.IsForOther(head)) return;
  {
    MutexLock lock(mutex_);
    const bool is_waiting = std::any_of(waiting_.begin(), waiting_.end(), [&](const auto& other) {
      return HeadOf(other).client == head.client && HeadOf(other).id == head.id;
    });
    if (is_waiting || waiting_.size() >= kMaxWaiting) return;
    waiting_.push_back(*std::move(request));
  }
  taken_.notify_one();
}

void CommandServer::Serve(const std::stop_token& stop) {
  while (true) {
    Request request;
    {
      std::unique_lock lock(mutex_);
      taken_.wait(lock, stop, [this] { return !waiting_.empty(); });
      if (stop.stop_requested()) return;
      request = std::move(waiting_.front());
      waiting_.pop_front();
    }
    const request_t& head = HeadOf(request);
    auto done = std::find_if(done_.begin(), done_.end(), [&](const Done& d) {
      return d.client == head.client && d.id == head.id;
    });
    if (done == done_.end()) {
      const absl::Status status = Run(request);
      command_reply_t reply;
      reply.head = replier_.HeadFor(head);
      SetStatus(status, reply.head);
      if (done_.size() >= kMaxRemembered) done_.pop_front();
      done_.push_back({head.client, head.id, Encode(reply)});
      done = done_.end() - 1;
    }
    replier_.Reply(head, done->reply);
  }
}

absl::Status CommandServer::Run(const Request& request) {
  if (!allowed_) {
    return absl::PermissionDeniedError(
        "splinemapd takes no commands from the bus: --no-remote-commands");
  }
  if (HeadOf(request).daemon_nonce == 0) {
    return absl::InvalidArgumentError("a command must name its daemon: daemon_nonce is 0");
  }
  return do_(request);
}

}  // namespace splinemap
