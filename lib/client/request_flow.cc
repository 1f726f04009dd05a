#include "lib/client/request_flow.h"

#include <algorithm>
#include <utility>

#include "absl/strings/str_join.h"
#include "lcmtypes/splinemap/reply_t.hpp"
#include "lcmtypes/splinemap/request_t.hpp"
#include "lib/base/plain_text.h"
#include "lib/base/status.h"
#include "lib/wire/decode.h"
#include "lib/wire/encode.h"

namespace splinemap {
namespace {

using std::chrono::milliseconds;

constexpr milliseconds kFirstPause(50);
constexpr milliseconds kLongestPause(500);
// Where a request was sent so often without a reply, the daemon may be another by now.
constexpr int kSentBeforeSearch = 3;
constexpr size_t kMaxHeard = 16;

}  // namespace

RequestFlow::RequestFlow(std::string channel_prefix, std::string robot, uint64_t client)
    : channel_prefix_(std::move(channel_prefix)), robot_(std::move(robot)), client_(client) {}

void RequestFlow::Seek(Clock::time_point now) {
  if (search_) return;
  search_ = Search{++last_number_, {now, kFirstPause}};
  heard_.clear();
  Tick(now);
}

int64_t RequestFlow::Start(std::unique_ptr<PendingRequest> request, Clock::time_point deadline,
                           Clock::time_point now) {
  const int64_t number = ++last_number_;
  Request& added = requests_[number];
  added.pending = std::move(request);
  added.deadline = deadline;
  Begin(number, added);
  Pump(now);
  return number;
}

void RequestFlow::Begin(int64_t number, Request& request) {
  std::erase_if(sent_, [&](const auto& sent) { return sent.second.request == number; });
  request.query = request.pending->num_chunks() > 1 ? ++last_number_ : 0;
  request.next_chunk = 0;
  request.answered = 0;
  request.revision.reset();
  if (!std::exchange(request.has_turn, true)) turns_.push_back(number);
}

// Chunks of many requests take turns, so that a long query does not keep a short one waiting.
void RequestFlow::Pump(Clock::time_point now) {
  while (daemon_ && sent_.size() < kMaxUnderWay && !turns_.empty()) {
    const int64_t number = turns_.front();
    turns_.pop_front();
    const auto found = requests_.find(number);
    if (found == requests_.end()) continue;
    Request& request = found->second;
    const int64_t id = ++last_number_;
    Sent& sent = sent_[id];
    sent = {number, request.next_chunk++, {now, kFirstPause}};
    IsDue(sent.retry, now);
    Send(id, sent);
    request.has_turn = request.next_chunk < request.pending->num_chunks();
    if (request.has_turn) turns_.push_back(number);
  }
}

bool RequestFlow::IsDue(Retry& retry, Clock::time_point now) {
  if (now < retry.next) return false;
  retry.next = now + retry.pause;
  retry.pause = std::min<Clock::duration>(retry.pause * 3 / 2, kLongestPause);
  ++retry.sent;
  return true;
}

void RequestFlow::Send(int64_t id, const Sent& sent) {
  const Request& request = requests_.at(sent.request);
  request_t header;
  header.client = static_cast<int64_t>(client_);
  header.id = id;
  header.query = request.query;
  header.daemon_nonce = static_cast<int64_t>(daemon_->nonce);
  outgoing_.push_back(
      {request.pending->Channel(channel_prefix_), request.pending->Encode(sent.chunk, header)});
}

std::unique_ptr<PendingRequest> RequestFlow::Remove(int64_t number) {
  const auto found = requests_.find(number);
  if (found == requests_.end()) return nullptr;
  std::erase_if(sent_, [&](const auto& sent) { return sent.second.request == number; });
  std::unique_ptr<PendingRequest> removed = std::move(found->second.pending);
  requests_.erase(found);
  return removed;
}

void RequestFlow::Finish(int64_t number, absl::Status status) {
  finished_.push_back({Remove(number), std::move(status)});
}

void RequestFlow::CancelAll() {
  while (!requests_.empty()) {
    Finish(requests_.begin()->first, absl::CancelledError("the client ends"));
  }
}

void RequestFlow::HandleMessage(absl::Span<const uint8_t> message, Clock::time_point now) {
  const std::optional<int64_t> id = ReplyIdOf(message);
  if (!id) return;
  if (search_ && *id == search_->id) {
    HandleSearchReply(message);
    Pump(now);
    return;
  }
  if (search_for_any_ == *id) HandleLaterSearchReply(message);
  const auto sent = sent_.find(*id);
  if (sent == sent_.end()) return;  // twice, or nobody waits any more
  const int64_t number = sent->second.request;
  Request& request = requests_.at(number);
  const absl::StatusOr<reply_t> header = request.pending->HandleReply(sent->second.chunk, message);
  if (!header.ok() || static_cast<uint64_t>(header->daemon_nonce) != daemon_->nonce) return;
  daemon_->session_number = static_cast<uint64_t>(header->session_number);
  search_.reset();
  absl::Status status = StatusOf(*header);
  if (absl::IsResourceExhausted(status)) {
    request.problem = ErrorText(status);  // and it is asked again
    return;
  }
  sent_.erase(sent);
  if (!status.ok()) {
    Finish(number, std::move(status));
  } else if (request.revision && *request.revision != header->revision) {
    Begin(number, request);  // the daemon has forgotten the state that it answered from
  } else {
    request.revision = header->revision;
    if (++request.answered == request.pending->num_chunks()) Finish(number, absl::OkStatus());
  }
  Pump(now);
}

void RequestFlow::HandleSearchReply(absl::Span<const uint8_t> message) {
  const auto reply = Decode<points_reply_t>(message);
  if (!reply.ok() || reply->header.daemon_nonce == 0) return;
  const reply_t& header = reply->header;
  if (!robot_.empty() && header.name != robot_) {
    const bool is_known = std::find(heard_.begin(), heard_.end(), header.name) != heard_.end();
    if (!is_known && heard_.size() < kMaxHeard) heard_.push_back(header.name);
    return;
  }
  if (robot_.empty()) {
    search_for_any_ = search_->id;
    found_ = {{header.name, header.revision}};
  }
  search_.reset();
  const auto nonce = static_cast<uint64_t>(header.daemon_nonce);
  const bool is_same = daemon_ && daemon_->nonce == nonce;
  robot_ = header.name;
  daemon_ = DaemonIdentity{header.name, nonce, static_cast<uint64_t>(header.session_number)};
  if (!is_same) BeginAllAnew();
}

void RequestFlow::HandleLaterSearchReply(absl::Span<const uint8_t> message) {
  const auto reply = Decode<points_reply_t>(message);
  if (!reply.ok() || reply->header.daemon_nonce == 0 || found_.size() >= kMaxHeard) return;
  found_.try_emplace(reply->header.name, reply->header.revision);
}

std::vector<std::string> RequestFlow::RobotsOfOtherMaps() const {
  std::vector<std::string> robots;
  const auto own = found_.find(robot_);
  for (const auto& [name, revision] : found_) {
    if (own != found_.end() && revision != own->second) robots.push_back(name);
  }
  return robots;
}

void RequestFlow::BeginAllAnew() {
  std::vector<int64_t> lost_commands;
  for (auto& [number, request] : requests_) {
    if (request.pending->is_command() && request.next_chunk > 0) {
      lost_commands.push_back(number);
    } else {
      Begin(number, request);
    }
  }
  for (const int64_t number : lost_commands) {
    Finish(number, Unavailable("splinemapd {} was started again; whether it did the {} before is "
                               "not known",
                               PlainText(robot_), requests_.at(number).pending->Describe()));
  }
}

void RequestFlow::Tick(Clock::time_point now) {
  std::vector<int64_t> late;
  for (const auto& [number, request] : requests_) {
    if (now >= request.deadline) late.push_back(number);
  }
  for (const int64_t number : late) Finish(number, Late(requests_.at(number)));
  bool has_no_poses = false;
  for (auto& [id, sent] : sent_) {
    if (!IsDue(sent.retry, now)) continue;
    Send(id, sent);
    has_no_poses = has_no_poses || sent.retry.sent % kSentBeforeSearch == 0;
  }
  if (has_no_poses && !search_) search_ = Search{++last_number_, {now, kFirstPause}};
  if (search_ && IsDue(search_->retry, now)) {
    points_request_t request{};
    request.header.client = static_cast<int64_t>(client_);
    request.header.id = search_->id;
    outgoing_.push_back({channel_prefix_ + Rpc<PointsQuery>::kChannel, Encode(request)});
  }
  Pump(now);
}

std::string RequestFlow::WhyNoDaemon() const {
  return fmt::format(
      "no splinemapd{} answers; does it run on this bus (LCM_DEFAULT_URL), with channel_prefix "
      "{}{}? "
      "splinemap watch shows who is there{}",
      robot_.empty() ? "" : " of " + PlainText(robot_), channel_prefix_,
      heard_.empty()
          ? ""
          : fmt::format(", and not only that of {}", PlainText(absl::StrJoin(heard_, ", "))),
      WhatIsDisbelieved());
}

std::string RequestFlow::WhatIsDisbelieved() const {
  return disbelieved_.empty() ? "" : fmt::format("; a reply is not believed: {}", disbelieved_);
}

absl::Status RequestFlow::Late(const Request& request) const {
  std::string text = fmt::format("{}: ", request.pending->Describe());
  if (!daemon_) {
    text += WhyNoDaemon();
  } else {
    text += fmt::format("splinemapd of {} answered {} of {} requests in time; {}",
                        PlainText(daemon_->name), request.answered, request.pending->num_chunks(),
                        request.problem.empty() ? "does it still run, and is the deadline long "
                                                  "enough? splinemap watch shows who is there"
                                                : request.problem);
  }
  if (daemon_) text += WhatIsDisbelieved();
  return absl::DeadlineExceededError(text);
}

}  // namespace splinemap
