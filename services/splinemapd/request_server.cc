#include "services/splinemapd/request_server.h"

#include <algorithm>
#include <optional>
#include <utility>

#include "lcmtypes/splinemap/command_reply_t.hpp"
#include "lcmtypes/splinemap/request_t.hpp"
#include "lib/base/status.h"
#include "lib/rpc/answer.h"
#include "lib/rpc/messages.h"
#include "lib/wire/decode.h"
#include "lib/wire/encode.h"

namespace splinemap {
namespace {

constexpr size_t kMaxPinned = 64;
constexpr std::ptrdiff_t kMaxPinnedOfLine = 8;
constexpr size_t kMaxRefusalsWaiting = 16;
constexpr size_t kMaxExecuting = 16;
constexpr size_t kMaxRemembered = 64;  // replies to commands
// Of 16 bytes each.
constexpr size_t kMaxSignedCommands = size_t{1} << 20;

bool IsCommand(absl::Span<const uint8_t> message) {
  const auto type = TypeOf(message);
  return type == MessageType::kCommandRequest || type == MessageType::kLayerCommandRequest;
}

}  // namespace

RequestServer::RequestServer(std::string channel_prefix, NewestMap& newest, Send send,
                             Execute execute, std::shared_ptr<const KeyRing> keys)
    : channel_prefix_(std::move(channel_prefix)),
      newest_(newest),
      daemon_nonce_(newest.Own().session.nonce),
      send_(std::move(send)),
      execute_(std::move(execute)),
      keys_(std::move(keys)),
      newest_map_(newest.View()) {}

void RequestServer::Stop() {
  MutexLock lock(mutex_);
  is_stopped_ = true;
}

std::vector<std::string> RequestServer::Channels(const std::string& channel_prefix) {
  std::vector<std::string> channels = QueryChannels(channel_prefix);
  channels.push_back(channel_prefix + kCommandChannel);
  return channels;
}

void RequestServer::Handle(absl::Span<const uint8_t> message) {
  const std::optional<request_t> header = RequestHeaderOf(message);
  MutexLock lock(mutex_);
  if (!header) {
    ++counts_.malformed;
    return;
  }
  const auto nonce = static_cast<uint64_t>(header->daemon_nonce);
  if (nonce != 0 && nonce != daemon_nonce_) {
    ++counts_.for_others;
    return;
  }
  if (message.size() > kMaxRpcBytes + kSignatureBytes) {
    Refuse(*header, message,
           InvalidArgument("a request of {} bytes; at most {} are allowed", message.size(),
                           kMaxRpcBytes));
  } else if (queue_.Push(*header, message) == RequestQueue::PushResult::kFull) {
    Refuse(*header, message,
           absl::ResourceExhaustedError(
               fmt::format("{} requests of one client wait, or {} in all; ask again a bit later",
                           RequestQueue::kMaxOfLine, RequestQueue::kMax)));
  }
}

void RequestServer::Refuse(const request_t& header, absl::Span<const uint8_t> message,
                           absl::Status why) {
  ++counts_.refused;
  if (refusals_.size() >= kMaxRefusalsWaiting) return;
  const absl::Span<const uint8_t> type = message.first(kFingerprintBytes);
  refusals_.push_back({{header, {type.begin(), type.end()}}, std::move(why)});
}

RequestServer::Counts RequestServer::counts() const {
  MutexLock lock(mutex_);
  return counts_;
}

bool RequestServer::NeedsServer() const {
  MutexLock lock(mutex_);
  return waiting_ && IsToServe();
}

void RequestServer::Serve() {
  {
    MutexLock lock(mutex_);
    if (!waiting_ || !IsToServe()) return;
    waiting_.reset();
  }
  while (true) {
    ServeNext();
    steps_.Add();
    MutexLock lock(mutex_);
    if (IsToServe()) continue;
    waiting_.emplace(steps_);
    return;
  }
}

void RequestServer::ServeNext() {
  std::optional<QueuedRequest> request;
  std::optional<Refusal> refusal;
  {
    MutexLock lock(mutex_);
    if (!refusals_.empty()) {
      refusal = std::move(refusals_.front());
      refusals_.pop_front();
    }
    if (!queue_.empty()) request = queue_.Pop();
  }
  if (request && IsCommand(request->bytes)) {
    ExecuteCommand(*request);
  } else if (request) {
    AnswerQuery(*request);
  }
  if (!refusal) return;
  const request_t& header = refusal->request.header;
  Reply(header, RefuseRequest(refusal->request.bytes, refusal->why, HeaderFor(header)));
}

void RequestServer::AnswerQuery(const QueuedRequest& request) {
  std::vector<uint8_t> reply =
      AnswerRequest(request.bytes, MapFor(request), HeaderFor(request.header));
  if (reply.empty()) {
    MutexLock lock(mutex_);
    ++counts_.malformed;
    return;
  }
  Reply(request.header, std::move(reply));
}

absl::Status RequestServer::CheckSigner(absl::Span<const uint8_t> command) const {
  if (keys_ == nullptr) return absl::OkStatus();
  SPLINEMAP_ASSIGN_OR_RETURN(const TrustedKey* key,
                             keys_->SignerOf(channel_prefix_ + kCommandChannel, command));
  if (key->decides) return absl::OkStatus();
  return absl::PermissionDeniedError(fmt::format(
      "signed by {}, whose key may not decide: splinemap keys trust .. --decides", key->name));
}

// The sender of a command that was signed and then changed by somebody does not believe this.
void RequestServer::RefuseSigner(const request_t& header, const absl::Status& why) {
  {
    MutexLock lock(mutex_);
    ++counts_.disbelieved;
    counts_.why = ErrorText(why);
  }
  command_reply_t reply;
  reply.header = HeaderFor(header);
  SetStatus(absl::PermissionDeniedError("the command is " + ErrorText(why)), reply.header);
  Reply(header, Encode(reply), /*is_signed=*/absl::IsPermissionDenied(why));
}

// A command that is sent again gets the reply that there was.
void RequestServer::ExecuteCommand(const QueuedRequest& request) {
  const request_t& header = request.header;
  if (const absl::Status status = CheckSigner(request.bytes); !status.ok()) {
    RefuseSigner(header, status);
    return;
  }
  const CommandId id{header.client, header.id};
  std::vector<uint8_t> reply;
  {
    MutexLock lock(mutex_);
    if (std::find(executing_.begin(), executing_.end(), id) != executing_.end()) return;
    const auto executed = std::find_if(executed_.begin(), executed_.end(),
                                       [&](const ExecutedCommand& e) { return e.id == id; });
    if (executed != executed_.end()) {
      reply = executed->reply;
    } else if (executing_.size() >= kMaxExecuting) {
      Refuse(header, request.bytes,
             absl::ResourceExhaustedError(fmt::format(
                 "{} commands are being executed; ask again a bit later", kMaxExecuting)));
      return;
    } else {
      executing_.push_back(id);
    }
  }
  if (!reply.empty()) {
    Reply(header, std::move(reply));
    return;
  }
  if (header.daemon_nonce == 0) {
    ReplyToCommand(header, InvalidArgument("a command must name its daemon: daemon_nonce is 0"));
    return;
  }
  if (keys_ != nullptr && signed_commands_.size() >= kMaxSignedCommands) {
    ReplyToCommand(header, absl::ResourceExhaustedError(fmt::format(
                               "{} signed commands were executed, which is the most; start "
                               "splinemapd again",
                               kMaxSignedCommands)));
    return;
  }
  if (keys_ != nullptr && !signed_commands_.insert(id).second) {
    ReplyToCommand(header, FailedPrecondition("the command was executed before"));
    return;
  }
  execute_(request.bytes,
           [this, header](const absl::Status& status) { ReplyToCommand(header, status); });
}

void RequestServer::ReplyToCommand(const request_t& header, const absl::Status& status) {
  const CommandId id{header.client, header.id};
  command_reply_t reply;
  reply.header = HeaderFor(header);
  SetStatus(status, reply.header);
  const std::vector<uint8_t> bytes = Encode(reply);
  {
    MutexLock lock(mutex_);
    std::erase(executing_, id);
    if (executed_.size() >= kMaxRemembered) executed_.pop_front();
    executed_.push_back({id, bytes});
  }
  Reply(header, bytes);
}

const LocalMap& RequestServer::MapFor(const QueuedRequest& request) {
  const request_t& header = request.header;
  const auto now = Clock::now();
  std::erase_if(pinned_, [&](const PinnedMap& pin) { return now - pin.last_used > kPinTime; });
  const auto is_for = [&](const PinnedMap& pin) {
    return header.query != 0 && pin.client == header.client && pin.query == header.query;
  };
  if (const auto pin = std::find_if(pinned_.begin(), pinned_.end(), is_for); pin != pinned_.end()) {
    pin->last_used = now;
    pin->line = request.line;  // it may be known by now
    std::rotate(pin, pin + 1, pinned_.end());
    return pinned_.back().map ? *pinned_.back().map : newest_map_;
  }
  UseNewest();
  if (header.query == 0) return newest_map_;
  const auto is_of_line = [&](const PinnedMap& pin) { return pin.line == request.line; };
  if (std::count_if(pinned_.begin(), pinned_.end(), is_of_line) >= kMaxPinnedOfLine) {
    pinned_.erase(std::find_if(pinned_.begin(), pinned_.end(), is_of_line));
  } else if (pinned_.size() >= kMaxPinned) {
    pinned_.pop_front();
  }
  pinned_.push_back({request.line, header.client, header.query, now, nullptr});
  return newest_map_;
}

void RequestServer::UseNewest() {
  auto map = newest_.View();
  if (map == newest_map_.View()) return;
  std::shared_ptr<const LocalMap> kept;
  for (PinnedMap& pin : pinned_) {
    if (pin.map) continue;
    if (!kept) kept = newest_map_.Keep();
    pin.map = kept;
  }
  newest_map_.Use(std::move(map));
}

reply_t RequestServer::HeaderFor(const request_t& request) const {
  const LayerSnapshot own = newest_.Own();
  reply_t header{};
  header.id = request.id;
  header.name = own.id.name;
  header.daemon_nonce = static_cast<int64_t>(daemon_nonce_);
  header.session_number = static_cast<int64_t>(own.session.number);
  return header;
}

void RequestServer::Reply(const request_t& request, std::vector<uint8_t> reply,
                          bool is_signed) const {
  const std::string channel = ReplyChannel(channel_prefix_, static_cast<uint64_t>(request.client));
  if (is_signed && keys_ != nullptr) keys_->Sign(channel, reply);
  send_(channel, reply);
}

}  // namespace splinemap
