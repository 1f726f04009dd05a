#pragma once

#include <atomic>
#include <chrono>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <thread>

#include "absl/status/status.h"
#include "lib/base/mutex.h"
#include "services/splinemapd/mailbox.h"
#include "services/splinemapd/newest_map.h"
#include "services/splinemapd/notice_log.h"
#include "splinemap/file.h"

namespace splinemap {

// Owns the map file: saves the newest map to it in a thread of its own, once each interval where it
// changed. Where the file is not there any more it is made anew, or the map goes on in a rescue
// file. Thread-safe.
class MapSaver {
 public:
  using Done = std::function<void(const absl::Status&)>;

  // `newest` and `notices` outlive it. Saves nothing before Start().
  MapSaver(MapFile file, NewestMap& newest, NoticeLog& notices);

  void Start(std::chrono::duration<double> interval);

  // Saves the newest map now. `done` runs in the saver's thread.
  void Save(Done done);
  // Saves the map with `own` in place of the own layer, and makes that the newest: a session is on
  // disk before anybody hears of it, so that no later start takes the same one.
  void SaveSession(LayerSnapshot own, Done done);

  // Commits of the own layer that are on disk; nothing where the file is gone.
  std::optional<uint64_t> saved_revision() const;
  // What the file has; and tiles that could not be saved the last time, which stay in memory.
  int64_t used_bytes() const { return used_bytes_; }
  size_t unsaved_tiles() const { return unsaved_tiles_; }
  const WorkSteps& steps() { return tasks_.steps(); }

  // Ends the thread, saves, closes the file. Unavailable where the map, or a part of it, could only
  // be saved elsewhere or not at all.
  absl::Status Stop();

 private:
  void Run(const std::stop_token& stop, std::chrono::duration<double> interval);
  void Report(const absl::Status& saved);
  absl::Status SaveNewest();
  absl::Status SaveSet(const LayerSet& set);
  absl::Status SaveHereOrElsewhere(const LayerSet& set);
  absl::Status SaveElsewhere(const LayerSet& set, const absl::Status& why);

  const std::string path_;  // that was asked for
  NewestMap& newest_;
  NoticeLog& notices_;
  Mailbox tasks_;
  // Of the thread, while it runs.
  MapFile file_;
  std::weak_ptr<const LayerSet> saved_;
  bool is_failing_ = false;
  LayerSet on_disk_;  // the tiles of the last save
  std::atomic<int64_t> used_bytes_{0};
  std::atomic<size_t> unsaved_tiles_{0};
  mutable Mutex mutex_;
  std::optional<uint64_t> saved_revision_ ABSL_GUARDED_BY(mutex_);
  std::jthread saving_;
};

}  // namespace splinemap
