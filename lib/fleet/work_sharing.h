#pragma once

#include <chrono>
#include <cstddef>
#include <cstdint>
#include <map>
#include <optional>
#include <set>
#include <string>
#include <string_view>
#include <vector>

#include "lib/base/clock.h"
#include "lib/fleet/query_tiles.h"

// Which worker has which parts of the map, decided by each for itself from who is there.

namespace splinemap {

// So many workers have each part, so that one may end.
inline constexpr size_t kOwners = 2;

// The owners of a part among the ids of all workers that are there; the first of them publishes its
// sum. Where a worker comes or goes, no parts move but those that it gets or had (rendezvous
// hashing).
std::vector<uint64_t> OwnersOf(int part, const std::set<uint64_t>& workers);

// What a worker tells the others once a second.
struct WorkerWord {
  uint64_t worker = 0;
  PartSet complete;  // it answers for them
};
std::string EncodeWord(const WorkerWord& word);
std::optional<WorkerWord> DecodeWord(std::string_view text);

// Which parts one worker is to have, as others come and go. Thread-compatible.
class WorkShare {
 public:
  // Who was not heard for so long is gone.
  static constexpr std::chrono::milliseconds kPatience{3500};
  // A part that others have now is answered for so long, by when clients and engine know.
  static constexpr std::chrono::milliseconds kHandOver{2000};
  static constexpr size_t kMaxWorkers = 4096;  // more are not heard

  explicit WorkShare(uint64_t worker) : worker_(worker) {}

  void Hear(const WorkerWord& word, Clock::time_point now);
  // To be called often. Parts that it does not own any more are kept until one of their owners has
  // them, and kHandOver after that.
  void Update(Clock::time_point now);

  const PartSet& owned() const { return owned_; }
  const PartSet& published() const { return published_; }  // first owner
  const PartSet& answered() const { return answered_; }    // owned, or being handed over
  // Those answered, and a moment after, so that nobody is answered without tiles.
  const PartSet& followed() const { return followed_; }
  size_t workers() const { return workers_; }  // that are there, with this one

 private:
  struct Heard {
    Clock::time_point when;
    PartSet complete;
  };
  const uint64_t worker_;
  std::map<uint64_t, Heard> heard_;  // of others
  std::map<int, Clock::time_point> kept_until_;
  PartSet owned_;
  PartSet published_;
  PartSet answered_;
  PartSet followed_;
  size_t workers_ = 1;
};

}  // namespace splinemap
