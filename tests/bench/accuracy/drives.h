#pragma once

#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "tests/bench/accuracy/effort.h"
#include "tests/bench/accuracy/tested_map.h"

namespace splinemap {

// A recorded drive: every other scan is for mapping, the rest judges the map.
struct JudgedDrive {
  std::string name;
  // Scans to be mapped, by the two rules for beams without return.
  std::vector<std::vector<PlacedBeam>> no_return_ignored;
  std::vector<std::vector<PlacedBeam>> no_return_free;
  // From every fourth hit of the other scans: the hit, a free point of the same beam anywhere up to
  // kMargin_m before it, and one between that and kNear_m before it, both uniformly.
  std::vector<Eigen::Vector2d> hits;
  std::vector<Eigen::Vector2d> free;
  std::vector<Eigen::Vector2d> free_near;
};

// Two knots of 0.05 m, the same for every resolution.
inline constexpr double kMargin_m = 0.1;
inline constexpr double kNear_m = 0.3;

// Those of the shared data folder that are there.
std::vector<JudgedDrive> ReadDrives(const Effort& effort);

std::unique_ptr<TestedMap> MapDrive(const Method& method, const JudgedDrive& drive,
                                    double resolution_m);

struct Judgement {
  double auc = 0;             // hits against all free points
  double auc_near = 0;        // hits against the free points near them: how sharp the map is
  double log_likelihood = 0;  // mean of hits and of free points, as many of both
};
Judgement Judge(TestedMap& map, const JudgedDrive& drive);
// The same of any surface, 0 where nothing is known.
using LogOddsAt = std::function<double(const Eigen::Vector2d& point_m)>;
Judgement Judge(const LogOddsAt& log_odds_at, const JudgedDrive& drive);

// hits.csv: how far held-out hits lie from the level of faces, at 0.05 m: median and 90 %.
void WriteHits(const std::vector<Method>& methods, const std::vector<JudgedDrive>& drives,
               const std::string& out);

// logs.csv: judgement and size of each method on each drive, by resolution.
void WriteLogs(const std::vector<Method>& methods, const std::vector<JudgedDrive>& drives,
               const std::string& out);

}  // namespace splinemap
