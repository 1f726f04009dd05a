#pragma once

#include <optional>
#include <vector>

#include "lcmtypes/splinemap/control_records_t.hpp"
#include "lib/map/layer_control.h"
#include "lib/replication/protocol.h"
#include "lib/replication/random_pause.h"

namespace splinemap {

// Keeps the decisions about layers equal among all on a bus. In every interval of a second each one
// tells the hash of its records, unless it has heard the same hash in that interval already; who
// hears another hash tells its records, unless somebody else does first. (The Trickle algorithm,
// RFC 6206, with an interval of one length.) Without clocks, threads or sockets of its own.
// Thread-compatible.
class ControlGossip {
 public:
  // `seed` spreads the times at which its users speak, and tells one from another.
  ControlGossip(LayerControls controls, uint64_t seed);

  const LayerControls& controls() const { return controls_; }

  // A decision of one's own, which is told at once.
  void Decide(const LayerId& id, const LayerControl& control);

  // Records that are not valid are ignored, and counted. True where a decision is new.
  bool Take(const control_records_t& message, Clock::time_point now);
  int64_t invalid() const { return invalid_; }

  // What is to be told now. Call it some times a second.
  std::vector<control_records_t> Tick(Clock::time_point now);

 private:
  void BeginInterval(Clock::time_point now);
  control_records_t Message() const;

  LayerControls controls_;
  RandomPause random_;
  int64_t sender_;
  int64_t invalid_ = 0;
  std::optional<Clock::time_point> interval_end_;
  Clock::time_point hash_due_;
  bool heard_same_ = false;  // in this interval
  bool told_ = false;        // in this interval
  std::optional<Clock::time_point> records_due_;
  Clock::time_point last_records_;
};

}  // namespace splinemap
