#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <functional>
#include <memory>
#include <string>

#include "absl/types/span.h"
#include "splinemap/scan.h"

namespace splinemap {

// Any kind of map, as the benchmark sees it. Thread-compatible.
class TestedMap {
 public:
  explicit TestedMap(double limit_log_odds) : limit_log_odds_(limit_log_odds) {}
  virtual ~TestedMap() = default;

  virtual void AddScan(absl::Span<const PlacedBeam> beams) = 0;
  // Occupied is positive; 0 where nothing is known.
  virtual double LogOdds(const Eigen::Vector2d& point_m) = 0;
  // Memory of the cells or control points, with what is allocated around those in use.
  virtual int64_t Bytes() const = 0;

  // Values stay within plus and minus this.
  double limit_log_odds() const { return limit_log_odds_; }
  // From -1 (free) to 1 (occupied), as the paper scales maps for (37).
  virtual double Scaled(const Eigen::Vector2d& point_m) { return LogOdds(point_m) / limit_log_odds_; }

 private:
  double limit_log_odds_;
};

// One row of a table: a way to make maps.
struct Method {
  std::string name;
  std::function<std::unique_ptr<TestedMap>(double resolution_m)> make;
  bool no_return_is_free = false;  // rather than ignored
  double level = 0;                // the log-odds of faces
};

}  // namespace splinemap
