#include "clients/client/map_client.h"

#include <algorithm>
#include <future>
#include <utility>
#include <vector>

#include "clients/client/pending_query.h"
#include "lib/base/clock.h"
#include "lib/base/random.h"
#include "lib/base/status.h"

namespace splinemap {
namespace {

// How exact deadlines and pauses are. Messages do not wait for it.
constexpr std::chrono::milliseconds kTick(10);
// So that points of time can be computed.
constexpr std::chrono::milliseconds kLongestDeadline = std::chrono::hours(24 * 365);

size_t NumItems(const PointsQuery& query) { return query.points_m.size(); }
size_t NumItems(const RaysQuery& query) { return query.rays.size(); }
size_t NumItems(const SweepsQuery& query) { return query.sweeps.size(); }
size_t NumItems(const RasterQuery&) { return 0; }  // which Check() limits
size_t NumItems(const LikelihoodsQuery& query) { return query.world_T_robot.size(); }
size_t NumItems(const DistancesQuery& query) { return query.points_m.size(); }

template <typename Query>
absl::Status CheckAll(const Query& query) {
  if (NumItems(query) > MapClient::kMaxItems) {
    return InvalidArgument("a query of {} {}; {} are allowed over LCM", NumItems(query),
                           Rpc<Query>::kName, MapClient::kMaxItems);
  }
  return Check(query);
}

}  // namespace

absl::StatusOr<std::unique_ptr<MapClient>> MapClient::Connect(const std::string& url,
                                                              ClientOptions options) {
  SPLINEMAP_ASSIGN_OR_RETURN(std::unique_ptr<LcmBus> bus, LcmBus::Open(url));
  std::unique_ptr<MapClient> client(new MapClient(std::move(bus), options));
  SPLINEMAP_RETURN_IF_ERROR(client->AwaitDaemon());
  return client;
}

MapClient::MapClient(std::unique_ptr<LcmBus> bus, const ClientOptions& options)
    : bus_(std::move(bus)),
      deadline_(options.deadline),
      flow_(options.channel_prefix, options.robot, RandomId()) {
  {
    MutexLock lock(mutex_);
    bus_->Subscribe(flow_.ReplyChannel(),
                    [this](const std::string&, absl::Span<const uint8_t> message) {
                      MutexLock inner_lock(mutex_);
                      flow_.HandleMessage(message, Clock::now());
                    });
    flow_.Seek(Clock::now());
  }
  running_ = std::jthread([this](const std::stop_token& stop) { Run(stop); });
}

MapClient::~MapClient() {
  running_.request_stop();
  running_.join();
  {
    MutexLock lock(mutex_);
    flow_.CancelAll();
  }
  Deliver();
}

absl::Status MapClient::AwaitDaemon() {
  std::unique_lock lock(mutex_);
  const bool is_found =
      found_.wait_for(lock, deadline_, [this] { return flow_.daemon().has_value(); });
  if (is_found) return absl::OkStatus();
  const std::string problem = bus_->Problem();
  return problem.empty() ? absl::DeadlineExceededError(flow_.WhyNoDaemon())
                         : absl::UnavailableError(problem);
}

void MapClient::Run(const std::stop_token& stop) {
  while (!stop.stop_requested()) {
    {
      MutexLock lock(mutex_);
      flow_.Tick(Clock::now());
      if (flow_.daemon()) found_.notify_all();
    }
    Deliver();
    bus_->Handle(kTick);
  }
}

void MapClient::Publish(const std::vector<RequestFlow::Outgoing>& outgoing) const {
  for (const auto& message : outgoing) bus_->PublishBytes(message.channel, message.bytes);
}

void MapClient::Deliver() {
  std::vector<RequestFlow::Outgoing> outgoing;
  std::vector<RequestFlow::Finished> finished;
  {
    MutexLock lock(mutex_);
    outgoing = flow_.TakeOutgoing();
    finished = flow_.TakeFinished();
  }
  Publish(outgoing);
  const std::string problem = bus_->Problem();
  for (const auto& [request, status] : finished) {
    const bool is_bus = absl::IsDeadlineExceeded(status) && !problem.empty();
    request->Finish(is_bus ? absl::UnavailableError(problem) : status);
  }
}

MapClient::RequestId MapClient::Add(std::unique_ptr<PendingRequest> request,
                                    std::chrono::milliseconds deadline) const {
  RequestId id = 0;
  std::vector<RequestFlow::Outgoing> outgoing;
  {
    MutexLock lock(mutex_);
    if (flow_.num_pending() < RequestFlow::kMaxRequests) {
      const auto now = Clock::now();
      id = flow_.Start(std::move(request), now + std::min(deadline, kLongestDeadline), now);
      outgoing = flow_.TakeOutgoing();
    }
  }
  if (request) {
    request->Finish(absl::ResourceExhaustedError(
        fmt::format("{} requests are under way", RequestFlow::kMaxRequests)));
  }
  Publish(outgoing);
  return id;
}

template <typename Query>
MapClient::RequestId MapClient::Start(
    Query query, std::chrono::milliseconds deadline,
    std::function<void(absl::StatusOr<typename Query::Answer>)> done) const {
  if (absl::Status status = CheckAll(query); !status.ok()) {
    done(std::move(status));
    return 0;
  }
  return Add(std::make_unique<PendingQuery<Query>>(std::move(query), std::move(done)), deadline);
}

template MapClient::RequestId MapClient::Start(
    PointsQuery, std::chrono::milliseconds,
    std::function<void(absl::StatusOr<PointsQuery::Answer>)>) const;
template MapClient::RequestId MapClient::Start(
    RaysQuery, std::chrono::milliseconds,
    std::function<void(absl::StatusOr<RaysQuery::Answer>)>) const;
template MapClient::RequestId MapClient::Start(
    SweepsQuery, std::chrono::milliseconds,
    std::function<void(absl::StatusOr<SweepsQuery::Answer>)>) const;
template MapClient::RequestId MapClient::Start(
    RasterQuery, std::chrono::milliseconds,
    std::function<void(absl::StatusOr<RasterQuery::Answer>)>) const;
template MapClient::RequestId MapClient::Start(
    LikelihoodsQuery, std::chrono::milliseconds,
    std::function<void(absl::StatusOr<LikelihoodsQuery::Answer>)>) const;
template MapClient::RequestId MapClient::Start(
    DistancesQuery, std::chrono::milliseconds,
    std::function<void(absl::StatusOr<DistancesQuery::Answer>)>) const;

void MapClient::Cancel(RequestId id) const {
  std::unique_ptr<PendingRequest> request;
  {
    MutexLock lock(mutex_);
    request = flow_.Remove(id);
  }
  if (request) request->Finish(absl::CancelledError("cancelled by the caller"));
}

template <typename Query>
absl::StatusOr<typename Query::Answer> MapClient::AskAndWait(const Query& query) const {
  using Answer = absl::StatusOr<typename Query::Answer>;
  std::promise<Answer> promise;
  std::future<Answer> answer = promise.get_future();
  Start(query, deadline_, [&promise](Answer a) { promise.set_value(std::move(a)); });
  return answer.get();
}

absl::StatusOr<PointsQuery::Answer> MapClient::Ask(const PointsQuery& query) const {
  return AskAndWait(query);
}
absl::StatusOr<RaysQuery::Answer> MapClient::Ask(const RaysQuery& query) const {
  return AskAndWait(query);
}
absl::StatusOr<SweepsQuery::Answer> MapClient::Ask(const SweepsQuery& query) const {
  return AskAndWait(query);
}
absl::StatusOr<RasterQuery::Answer> MapClient::Ask(const RasterQuery& query) const {
  return AskAndWait(query);
}
absl::StatusOr<LikelihoodsQuery::Answer> MapClient::Ask(const LikelihoodsQuery& query) const {
  return AskAndWait(query);
}
absl::StatusOr<DistancesQuery::Answer> MapClient::Ask(const DistancesQuery& query) const {
  return AskAndWait(query);
}

absl::Status MapClient::Save(std::chrono::milliseconds deadline) {
  return CommandMap("save", deadline);
}
absl::Status MapClient::Clear(std::chrono::milliseconds deadline) {
  return CommandMap("clear", deadline);
}

absl::Status MapClient::CommandMap(const std::string& command, std::chrono::milliseconds deadline) {
  command_request_t request;
  request.command = command;
  request.incarnation = static_cast<int64_t>(daemon().incarnation);
  return Command(std::move(request), deadline);
}

absl::Status MapClient::Decide(const LayerDecision& decision, std::chrono::milliseconds deadline) {
  layer_command_request_t request;
  request.command = decision.command;
  request.name = decision.layer.name;
  request.origin = static_cast<int64_t>(decision.layer.origin);
  request.incarnation = static_cast<int64_t>(decision.incarnation);
  request.shift_i = decision.shift.i;
  request.shift_j = decision.shift.j;
  return Command(std::move(request), deadline);
}

template <typename Request>
absl::Status MapClient::Command(Request request, std::chrono::milliseconds deadline) {
  std::promise<absl::Status> promise;
  std::future<absl::Status> status = promise.get_future();
  Add(std::make_unique<PendingCommand<Request>>(
          std::move(request), [&promise](absl::Status s) { promise.set_value(s); }),
      deadline);
  return status.get();
}

DaemonIdentity MapClient::daemon() const {
  MutexLock lock(mutex_);
  return *flow_.daemon();
}

}  // namespace splinemap
