#pragma once

#include <cstdint>
#include <list>
#include <map>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "lib/base/mutex.h"
#include "lib/base/status.h"
#include "lib/fleet/fleet_key.h"
#include "lib/fleet/fleet_store.h"

namespace splinemap {

// A bucket in this process, with the faults of an engine. Thread-safe.
class MemoryFleetStore : public FleetStore {
 public:
  absl::Status Put(absl::Span<const FleetEntry> entries) override {
    for (const FleetEntry& entry : entries) {
      MutexLock lock(mutex_);
      if (is_away_) return Unavailable("the store is away");
      if (writes_until_failure_ >= 0 && writes_until_failure_-- == 0) {
        // It is stored, and nobody is told.
        Store(entry);
        return Unavailable("the acknowledgement was lost");
      }
      Store(entry);
    }
    return absl::OkStatus();
  }

  absl::StatusOr<uint64_t> PutIf(const FleetEntry& entry, uint64_t expected) override {
    MutexLock lock(mutex_);
    if (is_away_) return Unavailable("the store is away");
    const auto found = entries_.find(entry.key);
    if ((found == entries_.end() ? 0 : found->second.revision) != expected) {
      return absl::AbortedError("it was written by somebody else");
    }
    return Store(entry);
  }

  absl::StatusOr<FleetEntry> Get(const std::string& key_or_filter) override {
    MutexLock lock(mutex_);
    if (is_away_) return Unavailable("the store is away");
    const FleetEntry* last = nullptr;
    for (const auto& [key, entry] : entries_) {
      if (MatchesFilter(key_or_filter, key) && (!last || entry.revision > last->revision)) {
        last = &entry;
      }
    }
    if (last == nullptr) return absl::OutOfRangeError("there is no " + key_or_filter);
    return *last;
  }

  absl::Status List(const std::string& filter, bool with_values,
                    absl::FunctionRef<void(FleetEntry entry)> visit) override {
    std::vector<FleetEntry> listed;
    {
      MutexLock lock(mutex_);
      ++lists_;
      if (is_away_) return Unavailable("the store is away");
      for (const auto& [key, entry] : entries_) {
        if (!MatchesFilter(filter, key)) continue;
        listed.push_back(entry);
        if (!with_values) listed.back().value.clear();
      }
    }
    for (FleetEntry& entry : listed) visit(std::move(entry));
    return absl::OkStatus();
  }

  absl::StatusOr<std::unique_ptr<FleetSubscription>> Subscribe(const std::string& filter,
                                                               Handler handler) override {
    MutexLock lock(mutex_);
    if (is_away_) return Unavailable("the store is away");
    const auto shared = std::make_shared<Subscriber>();
    shared->filter = filter;
    shared->handler = std::move(handler);
    subscribers_.push_back(shared);
    return std::make_unique<Subscription>(*this, shared);
  }

  uint64_t connections() const override {
    MutexLock lock(mutex_);
    return connections_;
  }

  // The connection is lost, and what changes meanwhile.
  void GoAway() {
    MutexLock lock(mutex_);
    is_away_ = true;
  }
  void ComeBack() {
    MutexLock lock(mutex_);
    is_away_ = false;
    ++connections_;
  }
  // Another process wrote it.
  void Write(const FleetEntry& entry) {
    MutexLock lock(mutex_);
    Store(entry);
  }
  // Changes are not told.
  void SetSilent(bool is_silent) {
    MutexLock lock(mutex_);
    is_silent_ = is_silent;
  }
  void FailAfterWrites(int writes) {
    MutexLock lock(mutex_);
    writes_until_failure_ = writes;
  }

  using Backup = std::map<std::string, FleetEntry>;
  Backup Save() const {
    MutexLock lock(mutex_);
    return entries_;
  }
  // Without a word to anybody.
  void Restore(Backup backup) {
    MutexLock lock(mutex_);
    entries_ = std::move(backup);
    revision_ = 0;
    for (const auto& [key, entry] : entries_) revision_ = std::max(revision_, entry.revision);
  }
  int64_t lists() const {
    MutexLock lock(mutex_);
    return lists_;
  }
  // How often keys were written.
  int64_t writes() const {
    MutexLock lock(mutex_);
    return writes_;
  }

 private:
  struct Subscriber {
    std::string filter;
    Handler handler;
  };
  class Subscription : public FleetSubscription {
   public:
    Subscription(MemoryFleetStore& store, std::shared_ptr<Subscriber> subscriber)
        : store_(store), subscriber_(std::move(subscriber)) {}
    ~Subscription() override {
      MutexLock lock(store_.mutex_);
      store_.subscribers_.remove(subscriber_);
    }

   private:
    MemoryFleetStore& store_;
    const std::shared_ptr<Subscriber> subscriber_;
  };

  uint64_t Store(FleetEntry entry) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_) {
    entry.revision = ++revision_;
    if (entry.value.empty()) entry.hash = 0;
    ++writes_;
    entries_[entry.key] = entry;
    for (const auto& subscriber : subscribers_) {
      if (!is_silent_ && !is_away_ && MatchesFilter(subscriber->filter, entry.key)) {
        subscriber->handler(entry);
      }
    }
    return revision_;
  }

  mutable Mutex mutex_;
  std::map<std::string, FleetEntry> entries_ ABSL_GUARDED_BY(mutex_);
  std::list<std::shared_ptr<Subscriber>> subscribers_ ABSL_GUARDED_BY(mutex_);
  uint64_t revision_ ABSL_GUARDED_BY(mutex_) = 0;
  uint64_t connections_ ABSL_GUARDED_BY(mutex_) = 1;
  int64_t lists_ ABSL_GUARDED_BY(mutex_) = 0;
  int64_t writes_ ABSL_GUARDED_BY(mutex_) = 0;
  int writes_until_failure_ ABSL_GUARDED_BY(mutex_) = -1;
  bool is_away_ ABSL_GUARDED_BY(mutex_) = false;
  bool is_silent_ ABSL_GUARDED_BY(mutex_) = false;
};

}  // namespace splinemap
