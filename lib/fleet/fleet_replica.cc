#include "lib/fleet/fleet_replica.h"

#include <algorithm>
#include <chrono>
#include <utility>

#include "lib/base/status.h"

namespace splinemap {
namespace {

using std::chrono::milliseconds;

// The engine may forget without a word.
constexpr std::chrono::seconds kCompareInterval(60);
// By then all servers of a cluster know of a subscription, and what was stored meanwhile was told
// to nobody.
constexpr milliseconds kSpread(2000);
constexpr milliseconds kRetry(1000);
constexpr milliseconds kGatherInterval(30);
constexpr milliseconds kLookInterval(1000);
// Of single entries.
constexpr size_t kMaxFetches = 64;
// Changes that wait to be handled; beyond, everything is compared instead.
constexpr size_t kMaxInboxBytes = size_t{64} << 20;

}  // namespace

FleetReplica::FleetReplica(FleetStore& store, FleetFollowOptions options, OnChange on_change)
    : store_(store),
      on_change_(std::move(on_change)),
      follower_(options),
      parts_(options.parts.value_or(std::set<int>())),
      following_([this](const std::stop_token& stop) { Run(stop); }) {}

FleetReplica::~FleetReplica() {
  following_.request_stop();
  following_.join();
}

LayerSet FleetReplica::Layers() const {
  MutexLock lock(mutex_);
  return follower_.Layers();
}

LayerSet FleetReplica::WholeLayers() const {
  MutexLock lock(mutex_);
  LayerSet set = follower_.Layers();
  std::vector<LayerSnapshot> whole;
  for (const LayerSnapshot& layer : set.layers) {
    if (const LayerSnapshot* snapshot = follower_.Whole(layer.id)) whole.push_back(*snapshot);
  }
  set.layers = std::move(whole);
  return set;
}

std::map<LayerId, LayerSettings> FleetReplica::ForgottenSettings() const {
  MutexLock lock(mutex_);
  std::map<LayerId, LayerSettings> forgotten;
  if (!is_compared_) return forgotten;
  for (const LayerId& id : follower_.ForgottenSettings()) {
    forgotten[id] = follower_.settings().Of(id);
  }
  return forgotten;
}

std::optional<MapOptions> FleetReplica::map_options() const {
  MutexLock lock(mutex_);
  return follower_.map_options();
}

std::vector<FollowedLayer> FleetReplica::FollowedLayers() const {
  MutexLock lock(mutex_);
  return follower_.FollowedLayers(Clock::now());
}

bool FleetReplica::HasCompared() const {
  MutexLock lock(mutex_);
  return is_compared_;
}

bool FleetReplica::IsCaughtUp() const {
  MutexLock lock(mutex_);
  return is_compared_ && follower_.IsWhole();
}

std::vector<std::string> FleetReplica::Refused() const {
  MutexLock lock(mutex_);
  return follower_.Refused();
}

int64_t FleetReplica::BytesReceived() const {
  MutexLock lock(mutex_);
  return bytes_received_;
}

std::string FleetReplica::Problem() const {
  MutexLock lock(mutex_);
  return problem_;
}

void FleetReplica::CompareAgain() {
  MutexLock lock(inbox_mutex_);
  compares_again_ = true;
  news_.notify_all();
}

void FleetReplica::SetParts(std::set<int> parts) {
  {
    MutexLock lock(mutex_);
    ++times_parts_were_set_;
    parts_ = parts;
    const auto is_other = [&](int part) { return !parts.contains(part); };
    std::erase_if(compared_, is_other);
    std::erase_if(complete_, is_other);
    follower_.SetParts(std::move(parts));
  }
  CompareAgain();
}

std::set<int> FleetReplica::CompleteParts() const {
  MutexLock lock(mutex_);
  return complete_;
}

void FleetReplica::Run(const std::stop_token& stop) {
  bool is_due = true;
  uint64_t connections = 0;
  Clock::time_point compared_at;
  Clock::time_point looked_at;
  Clock::time_point next_compare;
  while (!stop.stop_requested()) {
    Clock::time_point now = Clock::now();
    is_due |= connections != store_.connections() || now > next_compare;
    if (is_due && now - compared_at > kRetry) {
      has_new_subscription_ = std::exchange(connections, store_.connections()) != connections;
      const absl::Status compared = Compare(stop);
      now = compared_at = Clock::now();
      is_due = !compared.ok();
      next_compare = now + (has_new_subscription_ ? Clock::duration(kSpread) : kCompareInterval);
      MutexLock lock(mutex_);
      problem_ = ErrorText(compared);
      is_compared_ = compared.ok();
    }
    Drain();
    Publish();
    if (now - looked_at > kLookInterval) {
      looked_at = now;
      is_due |= HasNewFilter() || !CompareStalled(stop);
    }
    is_due |= WaitForNews(stop);
  }
}

bool FleetReplica::HasNewFilter() {
  MutexLock lock(mutex_);
  const std::vector<std::string> filters = follower_.Filters();
  return std::any_of(filters.begin(), filters.end(),
                     [&](const std::string& filter) { return !subscriptions_.contains(filter); });
}

// False where the engine is not there.
bool FleetReplica::CompareStalled(const std::stop_token& stop) {
  std::vector<std::string> stalled;
  {
    MutexLock lock(mutex_);
    if (!is_compared_) return true;
    stalled = follower_.DrainStalled(Clock::now());
  }
  return std::all_of(stalled.begin(), stalled.end(),
                     [&](const std::string& filter) { return CompareFilter(filter, stop).ok(); });
}

// Subscribes to what is not subscribed to yet, first, so that nothing falls between.
absl::Status FleetReplica::Compare(const std::stop_token& stop) {
  std::set<std::string> compared;
  uint64_t times_set = 0;
  {
    MutexLock lock(mutex_);
    times_set = times_parts_were_set_;
  }
  for (bool is_over = false; !is_over;) {
    is_over = true;
    std::vector<std::string> filters;
    {
      MutexLock lock(mutex_);
      filters = follower_.Filters();
    }
    std::erase_if(subscriptions_, [&](const auto& subscription) {
      return std::find(filters.begin(), filters.end(), subscription.first) == filters.end();
    });
    for (const std::string& filter : filters) {
      if (!compared.insert(filter).second) continue;
      is_over = false;
      if (stop.stop_requested()) return absl::CancelledError("it ends");
      if (!subscriptions_.contains(filter)) {
        has_new_subscription_ = true;
        SPLINEMAP_ASSIGN_OR_RETURN(
            subscriptions_[filter],
            store_.Subscribe(filter, [this](FleetEntry entry) { Receive(std::move(entry)); }));
      }
      if (absl::Status status = CompareFilter(filter, stop); !status.ok()) {
        subscriptions_.erase(filter);
        return status;
      }
      Drain();
    }
  }
  MutexLock lock(mutex_);
  if (times_set == times_parts_were_set_) compared_ = parts_;
  return absl::OkStatus();
}

absl::Status FleetReplica::CompareFilter(const std::string& filter, const std::stop_token& stop) {
  const auto list_values = [&] {
    return store_.List(filter, true, [&](const FleetEntry& entry) { Handle(entry); });
  };
  bool is_known = false;
  {
    MutexLock lock(mutex_);
    is_known = follower_.Knows(filter);
  }
  std::vector<std::string> wanted;
  if (is_known) {
    std::vector<FleetEntry> entries;
    SPLINEMAP_RETURN_IF_ERROR(
        store_.List(filter, false, [&](FleetEntry entry) { entries.push_back(std::move(entry)); }));
    MutexLock lock(mutex_);
    wanted = follower_.HandleList(filter, entries, Clock::now());
  }
  // One by one they would take as many round trips.
  if (!is_known || wanted.size() > kMaxFetches) {
    SPLINEMAP_RETURN_IF_ERROR(list_values());
  }
  for (const std::string& key : wanted) {
    if (stop.stop_requested()) return absl::CancelledError("it ends");
    {
      MutexLock lock(mutex_);
      if (follower_.Has(key)) continue;
    }
    const absl::StatusOr<FleetEntry> entry = store_.Get(key);
    if (!entry.ok() && !absl::IsOutOfRange(entry.status())) return entry.status();
    if (entry.ok()) {
      Handle(*entry);
    } else {
      MutexLock lock(mutex_);
      follower_.HandleGone(key, Clock::now());
    }
  }
  MutexLock lock(mutex_);
  follower_.NoteCompared(filter);
  return absl::OkStatus();
}

void FleetReplica::Handle(const FleetEntry& entry) {
  MutexLock lock(mutex_);
  bytes_received_ += static_cast<int64_t>(entry.value.size());
  follower_.Handle(entry, Clock::now());
}

void FleetReplica::Receive(FleetEntry entry) {
  MutexLock lock(inbox_mutex_);
  if (inbox_bytes_ > kMaxInboxBytes) {
    compares_again_ = true;
    return;
  }
  inbox_bytes_ += entry.value.size() + entry.key.size() + sizeof(FleetEntry);
  inbox_.push_back(std::move(entry));
  news_.notify_all();
}

// Whether everything is to be compared. News that come together are taken together.
bool FleetReplica::WaitForNews(const std::stop_token& stop) {
  std::unique_lock lock(inbox_mutex_);
  news_.wait_for(lock, stop, kLookInterval, [this] { return !inbox_.empty() || compares_again_; });
  news_.wait_for(lock, stop, kGatherInterval, [] { return false; });
  return std::exchange(compares_again_, false);
}

void FleetReplica::Drain() {
  std::vector<FleetEntry> entries;
  {
    MutexLock lock(inbox_mutex_);
    entries.swap(inbox_);
    inbox_bytes_ = 0;
  }
  MutexLock lock(mutex_);
  for (const FleetEntry& entry : entries) {
    bytes_received_ += static_cast<int64_t>(entry.value.size());
    follower_.Handle(entry, Clock::now());
  }
}

void FleetReplica::Publish() {
  LayerSet layers;
  std::set<int> compared;
  uint64_t times_set = 0;
  {
    MutexLock lock(mutex_);
    if (follower_.version() == published_version_) {
      complete_ = compared_;
      return;
    }
    published_version_ = follower_.version();
    layers = follower_.Layers();
    compared = compared_;
    times_set = times_parts_were_set_;
  }
  map_.Use(sum_.Update(layers));
  {
    MutexLock lock(mutex_);
    if (times_set == times_parts_were_set_) complete_ = std::move(compared);
  }
  if (on_change_) on_change_(*this);
}

}  // namespace splinemap
