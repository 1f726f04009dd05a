#include <algorithm>
#include <atomic>
#include <future>
#include <thread>
#include <utility>
#include <vector>

#include "lcmtypes/splinemap/command_request_t.hpp"
#include "lcmtypes/splinemap/layer_command_request_t.hpp"
#include "lib/base/clock.h"
#include "lib/base/mutex.h"
#include "lib/base/plain_text.h"
#include "lib/base/random.h"
#include "lib/base/status.h"
#include "lib/client/pending_query.h"
#include "lib/client/request_flow.h"
#include "lib/wire/decode.h"
#include "lib/wire/lcm_bus.h"
#include "splinemap/client.h"
#include "splinemap/key_ring.h"

namespace splinemap {
namespace {

// How exact deadlines and pauses are. Messages do not wait for it.
constexpr std::chrono::milliseconds kTick(10);
constexpr std::chrono::milliseconds kIdle(1000);
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

// A daemon replies in the name of the robot whose layer it maps.
absl::Status CheckSigner(const KeyRing& keys, const std::string& channel, const reply_t& header,
                         absl::Span<const uint8_t> message) {
  SPLINEMAP_ASSIGN_OR_RETURN(const TrustedKey* key, keys.SignerOf(channel, message));
  if (key->Maps(header.name)) return absl::OkStatus();
  return absl::PermissionDeniedError(
      fmt::format("signed by {}, whose key may not map {}", key->name, PlainText(header.name)));
}

}  // namespace

class MapClient::Impl {
 public:
  Impl(std::unique_ptr<LcmBus> bus, const ClientOptions& options);
  ~Impl();

  absl::Status AwaitDaemon();
  RequestId Add(std::unique_ptr<PendingRequest> request, std::chrono::milliseconds deadline);
  std::unique_ptr<PendingRequest> Remove(RequestId id) {
    MutexLock lock(mutex_);
    return flow_.Remove(id);
  }
  template <typename Query>
  absl::StatusOr<AnyAnswer> Ask(const Query& query);
  template <typename Request>
  absl::Status Command(Request request, std::chrono::milliseconds deadline);
  DaemonIdentity daemon() {
    MutexLock lock(mutex_);
    return *flow_.daemon();
  }
  std::vector<std::string> RobotsOfOtherMaps() {
    MutexLock lock(mutex_);
    return flow_.RobotsOfOtherMaps();
  }

 private:
  using Lock = std::unique_lock<Mutex>;

  void Receive(const std::string& channel, absl::Span<const uint8_t> message);
  void Run(const std::stop_token& stop);
  // These are called with mutex_ locked, and unlock it meanwhile.
  void Rest(Lock& lock, const std::stop_token& stop);
  template <typename Condition>
  void ReceiveUntil(Lock& lock, Condition is_done);
  void Step(Lock& lock, std::chrono::milliseconds timeout, bool is_own_thread);

  void Publish(std::vector<RequestFlow::Outgoing> outgoing) const;
  // Where it is not the client's thread, `callbacks_` keeps what only that may call.
  void Deliver(bool is_own_thread);

  const std::unique_ptr<LcmBus> bus_;
  const std::chrono::milliseconds deadline_;
  const std::shared_ptr<const KeyRing> keys_;
  Mutex mutex_;
  RequestFlow flow_ ABSL_GUARDED_BY(mutex_);
  ConditionVariable found_;
  // One thread at a time receives: of those that wait for an answer one, else the client's own.
  // So what is waited for is not handed over from thread to thread.
  ConditionVariable changed_;
  bool is_receiving_ ABSL_GUARDED_BY(mutex_) = true;  // somebody is
  bool is_resting_ ABSL_GUARDED_BY(mutex_) = false;   // the client's own thread is
  int num_waiting_ ABSL_GUARDED_BY(mutex_) = 0;       // for an answer
  Clock::time_point last_waited_ ABSL_GUARDED_BY(mutex_);
  std::vector<RequestFlow::Finished> callbacks_ ABSL_GUARDED_BY(mutex_);
  std::atomic<bool> is_idle_ = false;
  std::jthread running_;
};

MapClient::Impl::Impl(std::unique_ptr<LcmBus> bus, const ClientOptions& options)
    : bus_(std::move(bus)),
      deadline_(options.deadline),
      keys_(options.keys),
      flow_(options.channel_prefix, options.robot, RandomId()) {
  {
    MutexLock lock(mutex_);
    bus_->Subscribe(flow_.ReplyChannel(),
                    [this](const std::string& channel, absl::Span<const uint8_t> message) {
                      Receive(channel, message);
                    });
    flow_.Seek(Clock::now());
  }
  running_ = std::jthread([this](const std::stop_token& stop) { Run(stop); });
}

MapClient::Impl::~Impl() {
  running_.request_stop();
  running_.join();
  {
    MutexLock lock(mutex_);
    flow_.CancelAll();
  }
  Deliver(/*is_own_thread=*/true);
}

absl::Status MapClient::Impl::AwaitDaemon() {
  std::unique_lock lock(mutex_);
  const bool is_found =
      found_.wait_for(lock, deadline_, [this] { return flow_.daemon().has_value(); });
  if (is_found) return absl::OkStatus();
  const std::string problem = bus_->Problem();
  return problem.empty() ? absl::DeadlineExceededError(flow_.WhyNoDaemon())
                         : absl::UnavailableError(problem);
}

void MapClient::Impl::Run(const std::stop_token& stop) {
  const std::stop_callback wake(stop, [this] { bus_->Wake(); });
  Clock::time_point last_pending = Clock::now();
  Lock lock(mutex_);
  while (!stop.stop_requested()) {
    if (num_waiting_ > 0) Rest(lock, stop);
    if (!flow_.daemon() || flow_.num_pending() > 0) last_pending = Clock::now();
    is_idle_ = Clock::now() - last_pending > kIdle;
    Step(lock, is_idle_ ? kIdle : kTick, true);
  }
}

// As long as others receive, and a bit longer: who has asked may ask again.
void MapClient::Impl::Rest(Lock& lock, const std::stop_token& stop) {
  is_resting_ = true;
  is_receiving_ = false;
  changed_.notify_all();
  const auto is_needed = [this] { return num_waiting_ == 0 && flow_.num_pending() > 0; };
  while (!stop.stop_requested() && !is_needed() &&
         (num_waiting_ > 0 || Clock::now() - last_waited_ < kTick)) {
    changed_.wait_for(lock, stop, kTick, [&] { return !callbacks_.empty() || is_needed(); });
    if (callbacks_.empty()) continue;
    lock.unlock();
    Deliver(/*is_own_thread=*/true);
    lock.lock();
  }
  is_resting_ = false;
  is_receiving_ = true;
}

template <typename Condition>
void MapClient::Impl::ReceiveUntil(Lock& lock, Condition is_done) {
  ++num_waiting_;
  if (!is_resting_) bus_->Wake();
  changed_.wait(lock, [&] { return is_done() || !is_receiving_; });
  if (!is_done()) {
    is_receiving_ = true;
    while (!is_done()) Step(lock, kTick, false);
    is_receiving_ = false;
  }
  --num_waiting_;
  last_waited_ = Clock::now();
  if (num_waiting_ > 0 || flow_.num_pending() > 0) changed_.notify_all();
}

void MapClient::Impl::Step(Lock& lock, std::chrono::milliseconds timeout, bool is_own_thread) {
  lock.unlock();
  bus_->Handle(timeout);
  lock.lock();
  flow_.Tick(Clock::now());
  if (flow_.daemon()) found_.notify_all();
  lock.unlock();
  Deliver(is_own_thread);
  lock.lock();
}

void MapClient::Impl::Receive(const std::string& channel, absl::Span<const uint8_t> message) {
  const std::optional<reply_t> header = ReplyHeaderOf(message);
  if (!header) return;
  const absl::Status status =
      keys_ == nullptr ? absl::OkStatus() : CheckSigner(*keys_, channel, *header, message);
  MutexLock lock(mutex_);
  if (status.ok()) {
    flow_.HandleMessage(message, Clock::now());
    return;
  }
  std::string why = ErrorText(status);
  if (header->status != 0) why += "; it says: " + PlainText(header->status_text);
  flow_.HandleDisbelieved(why, header->status != 0);
}

void MapClient::Impl::Publish(std::vector<RequestFlow::Outgoing> outgoing) const {
  for (auto& message : outgoing) {
    bus_->PublishBytes(message.channel,
                       Signed(keys_.get(), message.channel, std::move(message.bytes)));
  }
}

void MapClient::Impl::Deliver(bool is_own_thread) {
  std::vector<RequestFlow::Outgoing> outgoing;
  std::vector<RequestFlow::Finished> finished;
  {
    MutexLock lock(mutex_);
    outgoing = flow_.DrainOutgoing();
    finished = flow_.DrainFinished();
    const auto callbacks = std::stable_partition(
        finished.begin(), finished.end(), [](const auto& f) { return f.request->is_waited_for(); });
    std::move(callbacks, finished.end(), std::back_inserter(callbacks_));
    finished.erase(callbacks, finished.end());
    if (is_own_thread) {
      std::move(callbacks_.begin(), callbacks_.end(), std::back_inserter(finished));
      callbacks_.clear();
    } else if (!callbacks_.empty()) {
      changed_.notify_all();
    }
  }
  Publish(std::move(outgoing));
  if (finished.empty()) return;
  const std::string problem = bus_->Problem();
  for (const auto& [request, status] : finished) {
    const bool is_bus = absl::IsDeadlineExceeded(status) && !problem.empty();
    request->Finish(is_bus ? absl::UnavailableError(problem) : status);
  }
}

MapClient::RequestId MapClient::Impl::Add(std::unique_ptr<PendingRequest> request,
                                          std::chrono::milliseconds deadline) {
  RequestId id = 0;
  std::vector<RequestFlow::Outgoing> outgoing;
  {
    MutexLock lock(mutex_);
    if (flow_.num_pending() < RequestFlow::kMaxRequests) {
      const auto now = Clock::now();
      const bool is_waited_for = request->is_waited_for();
      id = flow_.Start(std::move(request), now + std::min(deadline, kLongestDeadline), now);
      outgoing = flow_.DrainOutgoing();
      if (is_resting_ && !is_waited_for) changed_.notify_all();
    }
  }
  if (request) {
    request->Finish(absl::ResourceExhaustedError(
        fmt::format("{} requests are under way", RequestFlow::kMaxRequests)));
  }
  Publish(std::move(outgoing));
  if (is_idle_) bus_->Wake();  // it looks after deadlines now
  return id;
}

template <typename Query>
absl::StatusOr<AnyAnswer> MapClient::Impl::Ask(const Query& query) {
  using Answer = typename Query::Answer;
  std::optional<absl::StatusOr<AnyAnswer>> answer;
  const auto done = [&](absl::StatusOr<Answer> a) {
    MutexLock lock(mutex_);
    answer = std::move(a);
    if (num_waiting_ > 1) changed_.notify_all();  // it may be another's
  };
  Add(std::make_unique<PendingQuery<Query, const Query&>>(query, done), deadline_);
  Lock lock(mutex_);
  ReceiveUntil(lock, [&] { return answer.has_value(); });
  return *std::move(answer);
}

template <typename Request>
absl::Status MapClient::Impl::Command(Request request, std::chrono::milliseconds deadline) {
  std::promise<absl::Status> promise;
  std::future<absl::Status> status = promise.get_future();
  Add(std::make_unique<PendingCommand<Request>>(
          std::move(request), [&promise](absl::Status s) { promise.set_value(s); }),
      deadline);
  return status.get();
}

absl::StatusOr<std::unique_ptr<MapClient>> MapClient::Connect(const std::string& url,
                                                              ClientOptions options) {
  SPLINEMAP_ASSIGN_OR_RETURN(std::unique_ptr<LcmBus> bus, LcmBus::Open(url));
  std::unique_ptr<MapClient> client(new MapClient(std::make_unique<Impl>(std::move(bus), options)));
  SPLINEMAP_RETURN_IF_ERROR(client->impl_->AwaitDaemon());
  return client;
}

MapClient::MapClient(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
MapClient::~MapClient() = default;

template <typename Query>
MapClient::RequestId MapClient::Start(
    Query query, std::chrono::milliseconds deadline,
    std::function<void(absl::StatusOr<typename Query::Answer>)> done) const {
  if (absl::Status status = CheckAll(query); !status.ok()) {
    done(std::move(status));
    return 0;
  }
  return impl_->Add(std::make_unique<PendingQuery<Query>>(std::move(query), std::move(done)),
                    deadline);
}

void MapClient::Cancel(RequestId id) const {
  if (const auto request = impl_->Remove(id)) {
    request->Finish(absl::CancelledError("cancelled by the caller"));
  }
}

absl::StatusOr<AnyAnswer> MapClient::AskAny(const AnyQuery& query) const {
  return std::visit(
      [&](const auto* q) -> absl::StatusOr<AnyAnswer> {
        SPLINEMAP_RETURN_IF_ERROR(CheckAll(*q));
        return impl_->Ask(*q);
      },
      query);
}

absl::Status MapClient::Save(std::chrono::milliseconds deadline) {
  command_request_t request;
  request.command = "save";
  request.session_number = static_cast<int64_t>(daemon().session_number);
  return impl_->Command(std::move(request), deadline);
}

absl::Status MapClient::Clear(std::chrono::milliseconds deadline) {
  command_request_t request;
  request.command = "clear";
  request.session_number = static_cast<int64_t>(daemon().session_number);
  return impl_->Command(std::move(request), deadline);
}

absl::Status MapClient::Set(const LayerChange& change, std::chrono::milliseconds deadline) {
  layer_command_request_t request;
  request.command = NameOf(change.command);
  request.name = change.layer.name;
  request.origin = static_cast<int64_t>(change.layer.origin);
  request.session_number = static_cast<int64_t>(change.session_number);
  request.x_m = change.placement.position_m.x();
  request.y_m = change.placement.position_m.y();
  request.yaw_rad = change.placement.yaw_rad;
  return impl_->Command(std::move(request), deadline);
}

std::vector<std::string> MapClient::RobotsOfOtherMaps() const { return impl_->RobotsOfOtherMaps(); }

DaemonIdentity MapClient::daemon() const { return impl_->daemon(); }

#define SPLINEMAP_START(Query)                    \
  template MapClient::RequestId MapClient::Start( \
      Query, std::chrono::milliseconds, std::function<void(absl::StatusOr<Query::Answer>)>) const
SPLINEMAP_START(PointsQuery);
SPLINEMAP_START(RaysQuery);
SPLINEMAP_START(SweepsQuery);
SPLINEMAP_START(RasterQuery);
SPLINEMAP_START(LikelihoodsQuery);
SPLINEMAP_START(DistancesQuery);
#undef SPLINEMAP_START

}  // namespace splinemap
