#include "services/splinemapd/query_server.h"

#include <algorithm>
#include <optional>
#include <utility>

#include "lib/base/clock.h"
#include "lib/base/status.h"
#include "lib/rpc/answer.h"

namespace splinemap {
namespace {

constexpr size_t kMaxPins = 64;
constexpr std::ptrdiff_t kMaxPinsOfLine = 8;
constexpr size_t kMaxRefusalsWaiting = 16;

}  // namespace

QueryServer::QueryServer(Replier replier)
    : replier_(std::move(replier)),
      newest_(replier_.take_snapshot()),
      serving_([this](const std::stop_token& stop) { Serve(stop); }) {}

std::vector<std::string> QueryServer::Channels(const std::string& channel_prefix) {
  return {channel_prefix + Rpc<PointsQuery>::kChannel,
          channel_prefix + Rpc<RaysQuery>::kChannel,
          channel_prefix + Rpc<SweepsQuery>::kChannel,
          channel_prefix + Rpc<RasterQuery>::kChannel,
          channel_prefix + Rpc<LikelihoodsQuery>::kChannel,
          channel_prefix + Rpc<DistancesQuery>::kChannel};
}

void QueryServer::TakeRequest(absl::Span<const uint8_t> message) {
  const std::optional<request_t> head = RequestHeadOf(message);
  {
    MutexLock lock(mutex_);
    if (!head) {
      ++counts_.malformed;
      return;
    }
    if (replier_.IsForOther(*head)) {
      ++counts_.for_others;
      return;
    }
    if (message.size() > kMaxRpcBytes) {
      Refuse(
          *head, message,
          InvalidArgument("a request of {} bytes; {} are allowed", message.size(), kMaxRpcBytes));
    } else if (queue_.Push(*head, message) == RequestQueue::Pushed::kFull) {
      Refuse(*head, message,
             absl::ResourceExhaustedError(
                 fmt::format("{} requests of one client wait, or {} in all; ask again a bit later",
                             RequestQueue::kMaxOfLine, RequestQueue::kMax)));
    } else {
      ++counts_.taken;
    }
  }
  taken_.notify_one();
}

void QueryServer::Refuse(const request_t& head, absl::Span<const uint8_t> message,
                         absl::Status why) {
  ++counts_.refused;
  if (refusals_.size() >= kMaxRefusalsWaiting) return;
  const absl::Span<const uint8_t> type = message.first(sizeof(uint64_t));
  refusals_.push_back({{head, {type.begin(), type.end()}}, std::move(why)});
}

QueryServer::Counts QueryServer::counts() const {
  MutexLock lock(mutex_);
  return counts_;
}

void QueryServer::Serve(const std::stop_token& stop) {
  while (true) {
    std::optional<QueuedRequest> request;
    std::optional<Refusal> refusal;
    {
      std::unique_lock lock(mutex_);
      taken_.wait(lock, stop, [this] { return !queue_.empty() || !refusals_.empty(); });
      if (stop.stop_requested()) return;
      if (!refusals_.empty()) {
        refusal = std::move(refusals_.front());
        refusals_.pop_front();
      }
      if (!queue_.empty()) request = queue_.Pop();
    }
    if (request) Answer(*request);
    if (!refusal) continue;
    const request_t& head = refusal->request.head;
    replier_.Reply(head,
                   RefuseRequest(refusal->request.bytes, refusal->why, replier_.HeadFor(head)));
  }
}

void QueryServer::Answer(const QueuedRequest& request) {
  const std::vector<uint8_t> reply =
      AnswerRequest(request.bytes, MapFor(request), replier_.HeadFor(request.head));
  if (reply.empty()) {
    MutexLock lock(mutex_);
    ++counts_.malformed;
    return;
  }
  replier_.Reply(request.head, reply);
}

const LocalMap& QueryServer::MapFor(const QueuedRequest& request) {
  const request_t& head = request.head;
  const auto now = Clock::now();
  std::erase_if(pins_, [&](const Pin& pin) { return now - pin.last_used > kPinTime; });
  const auto is_for = [&](const Pin& pin) {
    return head.query != 0 && pin.client == head.client && pin.query == head.query;
  };
  if (const auto pin = std::find_if(pins_.begin(), pins_.end(), is_for); pin != pins_.end()) {
    pin->last_used = now;
    pin->line = request.line;  // it may be known by now
    std::rotate(pin, pin + 1, pins_.end());
    return pins_.back().map ? *pins_.back().map : newest_;
  }
  ShowNewest();
  if (head.query == 0) return newest_;
  const auto is_of_line = [&](const Pin& pin) { return pin.line == request.line; };
  if (std::count_if(pins_.begin(), pins_.end(), is_of_line) >= kMaxPinsOfLine) {
    pins_.erase(std::find_if(pins_.begin(), pins_.end(), is_of_line));
  } else if (pins_.size() >= kMaxPins) {
    pins_.pop_front();
  }
  pins_.push_back({request.line, head.client, head.query, now, nullptr});
  return newest_;
}

void QueryServer::ShowNewest() {
  auto map = replier_.take_snapshot();
  if (map == newest_.Snapshot()) return;
  std::shared_ptr<const LocalMap> kept;
  for (Pin& pin : pins_) {
    if (pin.map) continue;
    if (!kept) kept = newest_.Keep();
    pin.map = kept;
  }
  newest_.Show(std::move(map));
}

}  // namespace splinemap
