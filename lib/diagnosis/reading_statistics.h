#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "splinemap/scan.h"
#include "splinemap/sensor_options.h"

namespace splinemap {

// What is odd about the readings of a scan channel, and what to set or to do.
struct ReadingsComplaint {
  std::string text;                         // a clause: "its ranges seem to be millimetres ..."
  std::optional<double> right_range_max_m;  // where that mends it
};

// Counts the readings of a scan channel by range, to tell units that are none of LCM's messages,
// a sensor that sees further than range_max_m, and readings at one value below it that stand for
// "no return". Thread-compatible.
class ReadingStatistics {
 public:
  void Add(const RangeReadings& readings);

  int64_t scans() const { return scans_; }

  // Nothing where all is well, or where there are fewer than kMinScans. `range_max_m` is how the
  // channel is read.
  std::optional<ReadingsComplaint> Complain(double range_max_m) const;

  static constexpr int64_t kMinScans = 20;

 private:
  static constexpr double kBin_m = 0.01;
  static constexpr size_t kMaxBins = 40'000;  // 400 m

  // Of all readings, a share.
  double Share(int64_t readings) const;
  int64_t CountBetween(double from_m, double to_m) const;
  // The value of at least 2 % of readings, with a gap before it and next to nothing beyond.
  std::optional<double> PileUp() const;
  double Quantile(double share) const;

  int64_t scans_ = 0;
  int64_t readings_ = 0;  // of any value
  int64_t ranges_ = 0;    // that are positive and finite
  int64_t far_ = 0;       // of them beyond all bins
  // As long as all scans are such: whose bearings span more than a turn, whose beams all have one
  // bearing.
  int64_t scans_in_degrees_ = 0;
  int64_t scans_one_bearing_ = 0;
  std::vector<int64_t> bins_;  // readings of each centimetre, up to the longest
};

}  // namespace splinemap
