#pragma once

#include <map>
#include <optional>
#include <vector>

#include "absl/functional/function_ref.h"
#include "lcmtypes/splinemap/layer_settings_t.hpp"
#include "lcmtypes/splinemap/settings_t.hpp"
#include "lib/replication/protocol.h"
#include "lib/replication/random_backoff.h"
#include "splinemap/layer_settings.h"

namespace splinemap {

// `has_layer`: the speaker has the layer, or had it.
layer_settings_t ToMessage(const LayerId& id, const LayerSettings& setting, bool has_layer);
LayerSettings FromMessage(const layer_settings_t& message);

// Keeps the settings about layers equal among all on a bus. In every interval of a second each one
// tells the hash of its records, unless it has heard the same hash in that interval already; who
// hears another hash tells its records, unless somebody else does first. (The Trickle algorithm,
// RFC 6206, with an interval of one length.)
//
// Records about layers that were never here are strangers' business: 256 are kept, for an hour
// after somebody told them who has or had the layer, so that made-up ones take nobody's room and
// go away. Without clocks, threads or sockets of its own. Thread-compatible.
class SettingsGossip {
 public:
  static constexpr size_t kMaxStrangers = 256;
  static constexpr std::chrono::hours kStrangersStay{1};

  // Begins with records about layers that are here or were. `speaker` tells one from another, and
  // spreads the times at which they speak.
  SettingsGossip(SettingsTable settings, uint64_t speaker);

  const SettingsTable& settings() const { return settings_; }
  // Those about layers that are here or were: what is worth keeping on a disk.
  SettingsTable LastingSettings() const;

  // A setting of one's own about a layer that is here, which is told at once.
  void Set(const LayerId& id, const LayerSettings& setting);

  // The greatest start that is known of a layer that is here; nothing for others.
  using SessionNumberOf = absl::FunctionRef<std::optional<uint64_t>(const LayerId&)>;

  // Records that cannot be, and those that are further ahead than anybody can be, are refused and
  // counted; those whose counter is ahead only until they have been told for 10 s. True where a
  // setting is new.
  bool HandleSettings(const settings_t& message, SessionNumberOf session_number_of,
                      Clock::time_point now);
  int64_t refused() const { return refused_; }
  // Of the records of a message, those that would change something.
  int64_t CountNews(const settings_t& message) const;

  // A layer is here, in this start of its owner: what was heard of it before may be nonsense now.
  // True where that changes a setting.
  bool SetHere(const LayerId& id, uint64_t session_number);
  // A layer without content was forgotten, as if it had never been here.
  void SetStranger(const LayerId& id, Clock::time_point now);

  // What is to be told now. Call it some times a second.
  std::vector<settings_t> Tick(Clock::time_point now);
  // When that will have something to do, if nothing comes before.
  Clock::time_point NextTick() const;

 private:
  bool IsCredible(const LayerSettings& setting, const LayerSettings& known,
                  std::optional<uint64_t> session_number, Clock::time_point now);
  void DropOldestStranger();
  void ExpireStrangers(Clock::time_point now);
  void BeginInterval(Clock::time_point now);
  settings_t Message() const;

  SettingsTable settings_;
  RandomBackoff random_;
  int64_t speaker_;
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
