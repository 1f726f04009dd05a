#include "services/splinemapd/command_server.h"

#include <algorithm>

#include "lib/wire/encode.h"

namespace splinemap {
namespace {

constexpr size_t kMaxWaiting = 16;
constexpr size_t kMaxRemembered = 64;

}  // namespace

CommandServer::CommandServer(Replier replier, bool allowed, Do do_command)
    : replier_(std::move(replier)),
      allowed_(allowed),
      do_(std::move(do_command)),
      serving_([this](const std::stop_token& stop) { Serve(stop); }) {}

void CommandServer::TakeRequest(absl::Span<const uint8_t> message) {
  absl::StatusOr<command_request_t> request = DecodeRpc<command_request_t>(message);
  if (!request.ok() || replier_.IsForOther(request->head)) return;
  {
    MutexLock lock(mutex_);
    const bool is_waiting = std::any_of(waiting_.begin(), waiting_.end(), [&](const auto& other) {
      return other.head.client == request->head.client && other.head.id == request->head.id;
    });
    if (is_waiting || waiting_.size() >= kMaxWaiting) return;
    waiting_.push_back(*std::move(request));
  }
  taken_.notify_one();
}

void CommandServer::Serve(const std::stop_token& stop) {
  while (true) {
    command_request_t request;
    {
      std::unique_lock lock(mutex_);
      taken_.wait(lock, stop, [this] { return !waiting_.empty(); });
      if (stop.stop_requested()) return;
      request = std::move(waiting_.front());
      waiting_.pop_front();
    }
    const request_t& head = request.head;
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

absl::Status CommandServer::Run(const command_request_t& request) {
  if (!allowed_) {
    return absl::PermissionDeniedError(
        "splinemapd takes no commands from the bus: --no-remote-commands");
  }
  if (request.head.daemon_nonce == 0) {
    return absl::InvalidArgumentError("a command must name its daemon: daemon_nonce is 0");
  }
  return do_(request.command, static_cast<uint64_t>(request.incarnation));
}

}  // namespace splinemap
