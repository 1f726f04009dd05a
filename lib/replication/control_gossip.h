#pragma once

#include <map>
#include <optional>
#include <vector>

#include "absl/functional/function_ref.h"
#include "lcmtypes/splinemap/control_records_t.hpp"
#include "lib/map/layer_control.h"
#include "lib/replication/protocol.h"
#include "lib/replication/random_pause.h"

namespace splinemap {

// Keeps the decisions about layers equal among all on a bus. In every interval of a second each one
// tells the hash of its records, unless it has heard the same hash in that interval already; who
// hears another hash tells its records, unless somebody else does first. (The Trickle algorithm,
// RFC 6206, with an interval of one length.)
//
// Records about layers that were never here are strangers' business: 256 are kept, for an hour
// after somebody told them who has or had the layer, so that made-up ones take nobody's room and
// go away. Without clocks, threads or sockets of its own. Thread-compatible.
class ControlGossip {
 public:
  static constexpr size_t kMaxStrangers = 256;
  static constexpr std::chrono::hours kStrangersStay{1};

  // Begins with records about layers that are here or were. `seed` spreads the times at which its
  // users speak, and tells one from another.
  ControlGossip(LayerControls controls, uint64_t seed);

  const LayerControls& controls() const { return controls_; }
  // Those about layers that are here or were: what is worth keeping on a disk.
  LayerControls LastingControls() const;

  // A decision of one's own about a layer that is here, which is told at once.
  void Decide(const LayerId& id, const LayerControl& control);

  // The greatest start that is known of a layer that is here; nothing for others.
  using IncarnationOf = absl::FunctionRef<std::optional<uint64_t>(const LayerId&)>;

  // Records that cannot be, and those that are further ahead than anybody can be, are refused and
  // counted; those whose counter is ahead only until they have been told for 10 s. True where a
  // decision is new.
  bool Take(const control_records_t& message, IncarnationOf incarnation_of, Clock::time_point now);
  int64_t refused() const { return refused_; }
  // Of the records of a message, those that would change something.
  int64_t CountNews(const control_records_t& message) const;

  // A layer is here, in this start of its owner: what was heard of it before may be nonsense now.
  // True where that changes a decision.
  bool SetHere(const LayerId& id, uint64_t incarnation);
  // A layer without content was forgotten, as if it had never been here.
  void SetStranger(const LayerId& id, Clock::time_point now);

  // What is to be told now. Call it some times a second.
  std::vector<control_records_t> Tick(Clock::time_point now);

 private:
  bool IsCredible(const LayerControl& control, const LayerControl& known,
                  std::optional<uint64_t> incarnation, Clock::time_point now);
  void DropOldestStranger();
  void ExpireStrangers(Clock::time_point now);
  void BeginInterval(Clock::time_point now);
  control_records_t Message() const;

  LayerControls controls_;
  RandomPause random_;
  int64_t sender_;
  int64_t refused_ = 0;
  // Records about layers that were never here: since when nobody who has the layer told them.
  std::map<LayerId, Clock::time_point> strangers_;
  // Records that expired, and when: those who have them still do not bring them back.
  std::map<LayerId, Clock::time_point> expired_;
  // Records whose counter is ahead of all that is known: when the first and the last were told.
  std::optional<Clock::time_point> ahead_since_;
  Clock::time_point ahead_last_;
  std::optional<Clock::time_point> interval_end_;
  Clock::time_point hash_due_;
  bool heard_same_ = false;  // in this interval
  bool told_ = false;        // in this interval
  std::optional<Clock::time_point> records_due_;
  Clock::time_point last_records_;
};

}  // namespace splinemap
