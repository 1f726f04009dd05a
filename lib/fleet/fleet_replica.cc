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
constexpr milliseconds kPublishInterval(50);
constexpr milliseconds kLongestWait(100);
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
  Clock::time_point published_at;
  Clock::time_point next_compare;
  while (!stop.stop_requested()) {
    is_due |= connections != store_.connections() || Clock::now() > next_compare;
    if (is_due && Clock::now() - compared_at > kRetry) {
      const size_t subscriptions = subscriptions_.size();
      const uint64_t before = std::exchange(connections, store_.connections());
      const absl::Status compared = Compare();
      compared_at = Clock::now();
      is_due = !compared.ok();
      next_compare = compared_at + (before == connections && subscriptions == subscriptions_.size()
                                        ? Clock::duration(kCompareInterval)
                                        : Clock::duration(kSpread));
      MutexLock lock(mutex_);
      problem_ = ErrorText(compared);
      is_compared_ = compared.ok();
    }
    Drain();
    if (Clock::now() - published_at > kPublishInterval) {
      Publish();
      published_at = Clock::now();
    }
    {
      MutexLock lock(mutex_);
      is_due |= follower_.HasStalled(Clock::now(), compared_at);
      const std::vector<std::string> filters = follower_.Filters();
      is_due |= std::any_of(filters.begin(), filters.end(), [&](const std::string& filter) {
        return !subscriptions_.contains(filter);
      });
    }
    is_due |= WaitForNews(stop);
  }
}

// Subscribes to what is not subscribed to yet, first, so that nothing falls between.
absl::Status FleetReplica::Compare() {
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
      if (!subscriptions_.contains(filter)) {
        SPLINEMAP_ASSIGN_OR_RETURN(
            subscriptions_[filter],
            store_.Subscribe(filter, [this](FleetEntry entry) { Inbox(std::move(entry)); }));
      }
      if (absl::Status status = CompareFilter(filter); !status.ok()) {
        subscriptions_.erase(filter);
        return status;
      }
    }
  }
  MutexLock lock(mutex_);
  if (times_set == times_parts_were_set_) compared_ = parts_;
  return absl::OkStatus();
}

absl::Status FleetReplica::CompareFilter(const std::string& filter) {
  bool is_known = false;
  {
    MutexLock lock(mutex_);
    is_known = follower_.Knows(filter);
  }
  if (!is_known) {
    // Values are handled as they come.
    SPLINEMAP_RETURN_IF_ERROR(store_.List(filter, true, [&](const FleetEntry& entry) {
      MutexLock lock(mutex_);
      bytes_received_ += static_cast<int64_t>(entry.value.size());
      follower_.Handle(entry, Clock::now());
    }));
    return absl::OkStatus();
  }
  std::vector<FleetEntry> entries;
  SPLINEMAP_RETURN_IF_ERROR(
      store_.List(filter, false, [&](FleetEntry entry) { entries.push_back(std::move(entry)); }));
  std::vector<std::string> wanted;
  {
    MutexLock lock(mutex_);
    wanted = follower_.HandleList(filter, entries, Clock::now());
  }
  for (const std::string& key : wanted) {
    const absl::StatusOr<FleetEntry> entry = store_.Get(key);
    if (!entry.ok() && !absl::IsOutOfRange(entry.status())) return entry.status();
    MutexLock lock(mutex_);
    if (entry.ok()) {
      bytes_received_ += static_cast<int64_t>(entry->value.size());
      follower_.Handle(*entry, Clock::now());
    } else {
      follower_.HandleGone(key, Clock::now());
    }
  }
  return absl::OkStatus();
}

void FleetReplica::Inbox(FleetEntry entry) {
  MutexLock lock(inbox_mutex_);
  if (inbox_bytes_ > kMaxInboxBytes) {
    compares_again_ = true;
    return;
  }
  inbox_bytes_ += entry.value.size() + entry.key.size() + sizeof(FleetEntry);
  inbox_.push_back(std::move(entry));
  news_.notify_all();
}

// Whether everything is to be compared.
bool FleetReplica::WaitForNews(const std::stop_token& stop) {
  std::unique_lock lock(inbox_mutex_);
  news_.wait_for(lock, stop, kLongestWait, [this] { return !inbox_.empty() || compares_again_; });
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
