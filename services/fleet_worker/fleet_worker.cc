#include "services/fleet_worker/fleet_worker.h"

#include <xxhash.h>

#include <algorithm>
#include <chrono>
#include <set>
#include <utility>

#include "absl/strings/match.h"
#include "lib/base/random.h"
#include "lib/base/status.h"
#include "lib/config/config.h"
#include "lib/fleet/answer_query.h"
#include "lib/fleet/fleet_file.h"
#include "lib/fleet/fleet_map.h"
#include "lib/fleet/fleet_settings.h"
#include "lib/fleet/layer_digest.h"

namespace splinemap {
namespace {

using std::chrono::milliseconds;

constexpr milliseconds kTellInterval(1000);
// Before it takes parts it listens who is there.
constexpr milliseconds kListen(1500);
// So that a block of the sum is written five times a second at most.
constexpr milliseconds kPublishInterval(200);
constexpr milliseconds kKeepInterval(5000);
constexpr milliseconds kLongestPause(16'000);
// While servers that have just started choose a leader.
constexpr milliseconds kStartPatience(30'000);
constexpr int kReplicas = 3;
// That wait for a thread; what is beyond is refused, and asked again.
constexpr size_t kMaxRequests = 1024;

std::set<int> NumbersOf(const PartSet& parts) {
  std::set<int> numbers;
  for (int part = 0; part < kParts; ++part) {
    if (parts[static_cast<size_t>(part)]) numbers.insert(part);
  }
  return numbers;
}

PartSet SetOf(const std::set<int>& numbers) {
  PartSet parts;
  for (const int part : numbers) parts.set(static_cast<size_t>(part));
  return parts;
}

FleetFollowOptions NoPartsYet() {
  FleetFollowOptions options;
  options.parts.emplace();
  return options;
}

FleetAddress AddressOfSum(FleetAddress address) {
  address.map += "_sum";
  return address;
}

std::string WorkersSubject(const FleetAddress& address) {
  return fmt::format("splinemap.{}.workers", address.map);
}

absl::Status MakeBucket(const WorkerOptions& options, NatsFleetStore& store) {
  const absl::Status made = store.MakeBucket(options.replicas.value_or(kReplicas));
  const bool is_one_server = absl::StrContains(ErrorText(made), "non-clustered");
  return is_one_server && !options.replicas ? store.MakeBucket(1) : made;
}

// The buckets and the map's record, where they are not there, or the servers have lost them: then
// as they were `known`.
absl::Status MakeMap(const WorkerOptions& options, NatsFleetStore& store, NatsFleetStore& files,
                     const std::optional<MapOptions>& known) {
  SPLINEMAP_RETURN_IF_ERROR(MakeBucket(options, store));
  SPLINEMAP_RETURN_IF_ERROR(MakeBucket(options, files));  // of map files, which workers never read
  const absl::StatusOr<FleetEntry> entry = store.Get(kMapKey);
  if (!entry.ok() && !absl::IsOutOfRange(entry.status())) return entry.status();
  config::Method method;
  if (options.knot_interval_m) method.set_knot_interval_m(*options.knot_interval_m);
  const MapOptions begun = known ? *known : MapOptionsOf(method);
  if (entry.ok() && !entry->value.empty()) {
    SPLINEMAP_ASSIGN_OR_RETURN(const MapOptions found, DecodeMapOptions(entry->value));
    if (!options.knot_interval_m || found.knot_interval_m == *options.knot_interval_m) {
      return absl::OkStatus();
    }
    return FailedPrecondition(
        "the map '{}' has knots {} m apart, not {} m: leave out --knot-interval-m, or begin "
        "another map with --fleet-map",
        options.fleet.map, found.knot_interval_m, *options.knot_interval_m);
  }
  const std::string value = EncodeMapOptions(begun);
  const uint64_t hash = std::max<uint64_t>(XXH3_64bits(value.data(), value.size()), 1);
  const uint64_t expected = entry.ok() ? entry->revision : 0;
  const absl::Status put = store.PutIf({kMapKey, value, hash}, expected).status();
  // Where another worker was faster, with another knot interval maybe.
  return absl::IsAborted(put) ? MakeMap(options, store, files, known) : put;
}

struct Stores {
  std::unique_ptr<NatsFleetStore> map;
  std::unique_ptr<NatsFleetStore> files;
  std::unique_ptr<NatsFleetStore> sum;
};

absl::Status ConnectAndMakeMap(const WorkerOptions& options, Stores& stores) {
  for (const auto& [store, address] :
       {std::pair(&stores.map, options.fleet), std::pair(&stores.files, FilesOf(options.fleet)),
        std::pair(&stores.sum, AddressOfSum(options.fleet))}) {
    if (*store) continue;
    SPLINEMAP_ASSIGN_OR_RETURN(*store, NatsFleetStore::Connect(address));
  }
  return MakeMap(options, *stores.map, *stores.files, std::nullopt);
}

}  // namespace

absl::StatusOr<std::unique_ptr<FleetWorker>> FleetWorker::Start(const WorkerOptions& options) {
  Stores stores;
  const Clock::time_point end = Clock::now() + kStartPatience;
  absl::Status made = ConnectAndMakeMap(options, stores);
  while (absl::IsUnavailable(made) && Clock::now() < end) {
    std::this_thread::sleep_for(kTellInterval);
    made = ConnectAndMakeMap(options, stores);
  }
  SPLINEMAP_RETURN_IF_ERROR(made);
  std::unique_ptr<FleetWorker> worker(new FleetWorker(
      options, std::move(stores.map), std::move(stores.files), std::move(stores.sum)));
  const auto handler = [self = worker.get()](const std::string& message) {
    const std::optional<WorkerWord> word = DecodeWord(message);
    if (!word) return;
    MutexLock lock(self->mutex_);
    self->share_.Hear(*word, Clock::now());
  };
  SPLINEMAP_ASSIGN_OR_RETURN(worker->listening_,
                             worker->store_->Listen(WorkersSubject(options.fleet), handler));
  return worker;
}

FleetWorker::FleetWorker(const WorkerOptions& options, std::unique_ptr<NatsFleetStore> store,
                         std::unique_ptr<NatsFleetStore> files,
                         std::unique_ptr<NatsFleetStore> sum_store)
    : options_(options),
      id_(RandomId()),
      store_(std::move(store)),
      files_(std::move(files)),
      sum_store_(std::move(sum_store)),
      replica_(*store_, NoPartsYet()),
      listening_since_(Clock::now()),
      share_(id_) {
  const unsigned threads = std::max(2u, std::thread::hardware_concurrency());
  for (unsigned k = 0; k < threads; ++k) {
    answering_.emplace_back([this](const std::stop_token& stop) { AnswerAll(stop); });
  }
  publishing_ = std::jthread([this](const std::stop_token& stop) { Publish(stop); });
}

FleetWorker::~FleetWorker() {
  listening_.reset();
  subscriptions_.clear();
  for (std::jthread& thread : answering_) thread.request_stop();
  publishing_.request_stop();
  answering_.clear();
  publishing_.join();
}

void FleetWorker::Tick() {
  const Clock::time_point now = Clock::now();
  if (now - told_at_ >= kTellInterval) {
    Tell();
    told_at_ = now;
  }
  // Who hears nobody since the engine is away is not alone.
  if (const uint64_t connections = store_->connections();
      connections != connections_ || !store_->Problem().empty()) {
    connections_ = connections;
    listening_since_ = now;
  }
  if (now - listening_since_ < kListen) return;
  PartSet complete = SetOf(replica_.CompleteParts());
  PartSet followed;
  PartSet served;
  PartSet owned;
  {
    MutexLock lock(mutex_);
    share_.Update(now);
    followed = share_.followed();
    owned = share_.owned();
    served = share_.answered() & complete;
    if ((served_ & ~served).any()) ++times_withdrawn_;
    served_ = served;
    published_ = share_.published() & complete;
  }
  const PartSet told = ServedParts();
  Serve(served);
  if (followed != followed_) replica_.SetParts(NumbersOf(followed));
  followed_ = followed;
  is_ready_ = (owned & ~ServedParts()).none();
  // Others that hand parts over wait for this.
  if (ServedParts() != told) Tell();
}

PartSet FleetWorker::ServedParts() const {
  PartSet parts;
  for (const auto& [part, subscription] : subscriptions_) parts.set(static_cast<size_t>(part));
  return parts;
}

void FleetWorker::Tell() {
  // Where it does not get through, others take over.
  store_->Tell(WorkersSubject(options_.fleet), EncodeWord({id_, ServedParts()})).IgnoreError();
}

void FleetWorker::Serve(const PartSet& parts) {
  std::erase_if(subscriptions_, [&](const auto& subscription) {
    return !parts[static_cast<size_t>(subscription.first)];
  });
  for (const int part : NumbersOf(parts)) {
    if (subscriptions_.contains(part)) continue;
    auto subscription = store_->Serve(AskSubject(options_.fleet.map, part), "workers",
                                      [this](std::string request, std::string reply_to) {
                                        Take({std::move(request), std::move(reply_to)});
                                      });
    if (subscription.ok()) subscriptions_[part] = *std::move(subscription);
  }
}

void FleetWorker::Take(Request request) {
  {
    MutexLock lock(requests_mutex_);
    if (requests_.size() < kMaxRequests) {
      requests_.push_back(std::move(request));
      arrived_.notify_one();
      return;
    }
  }
  store_->Tell(request.reply_to, EncodeReply(Unavailable("this worker has too much to do")))
      .IgnoreError();
}

void FleetWorker::AnswerAll(const std::stop_token& stop) {
  while (true) {
    Request request;
    {
      std::unique_lock lock(requests_mutex_);
      if (!arrived_.wait(lock, stop, [this] { return !requests_.empty(); })) return;
      request = std::move(requests_.front());
      requests_.pop_front();
    }
    // Whoever asked asks again where it gets nothing.
    store_->Tell(request.reply_to, AnswerTo(request.bytes)).IgnoreError();
  }
}

std::string FleetWorker::AnswerTo(const std::string& bytes) {
  PartSet parts;
  uint64_t times_withdrawn = 0;
  {
    MutexLock lock(mutex_);
    parts = served_;
    times_withdrawn = times_withdrawn_;
  }
  std::string reply = AnswerQuery(bytes, replica_.map(), parts);
  MutexLock lock(mutex_);
  if (times_withdrawn == times_withdrawn_) return reply;
  // The replica may have forgotten tiles meanwhile.
  return EncodeReply(Unavailable("this worker hands parts over"));
}

void FleetWorker::Publish(const std::stop_token& stop) {
  SumUpload upload(*sum_store_);
  Clock::time_point kept_at = Clock::now();
  Clock::duration pause = kPublishInterval;
  Mutex mutex;
  ConditionVariable never;
  while (!stop.stop_requested()) {
    {
      std::unique_lock lock(mutex);
      never.wait_for(lock, stop, pause, [] { return false; });
    }
    if (Clock::now() - kept_at > kKeepInterval) {
      const absl::Status kept = KeepMap();
      kept_at = Clock::now();
      MutexLock lock(mutex_);
      keep_problem_ = ErrorText(kept);
    }
    PartSet parts;
    {
      MutexLock lock(mutex_);
      parts = published_;
    }
    const absl::Status published = upload.Bring(*replica_.View(), parts);
    pause = published.ok() ? kPublishInterval : std::min<Clock::duration>(4 * pause, kLongestPause);
    MutexLock lock(mutex_);
    publish_problem_ = ErrorText(published);
  }
}

// What the engine may have forgotten, and no robot can tell it.
absl::Status FleetWorker::KeepMap() {
  SPLINEMAP_RETURN_IF_ERROR(MakeMap(options_, *store_, *files_, replica_.map_options()));
  SPLINEMAP_RETURN_IF_ERROR(sum_store_->MakeBucket(1));  // what it has is made of the other
  for (const auto& [id, settings] : replica_.ForgottenSettings()) {
    SPLINEMAP_RETURN_IF_ERROR(KeepSettings(*store_, id, settings));
  }
  return absl::OkStatus();
}

std::string FleetWorker::Description() const {
  MutexLock lock(mutex_);
  return fmt::format("worker {:016x}, one of {}, answers for {} of {} parts of the map '{}'", id_,
                     share_.workers(), served_.count(), kParts, options_.fleet.map);
}

std::string FleetWorker::Problem() const {
  for (const std::string& problem : {store_->Problem(), replica_.Problem()}) {
    if (!problem.empty()) return problem;
  }
  MutexLock lock(mutex_);
  return keep_problem_.empty() ? publish_problem_ : keep_problem_;
}

}  // namespace splinemap
