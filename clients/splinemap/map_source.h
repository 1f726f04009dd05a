#pragma once

#include <CLI/App.hpp>
#include <Eigen/Core>
#include <memory>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "absl/types/span.h"
#include "lib/client/map_client.h"
#include "lib/query/queryable_map.h"

namespace splinemap {

// What commands share that ask a map file or, with --live, the map of a daemon.
struct MapSourceFlags {
  std::vector<std::string> words;  // a map file unless `live`, and what the command takes
  bool live = false;
  std::string lcm_url;
  ClientOptions client;
  double timeout_s = 2;
};

// `words` is how --help calls the words of the command, `what` explains them.
void AddAskedMapFlags(CLI::App& command, const std::string& words, const std::string& what,
                      MapSourceFlags& flags);

// The words after the map file. InvalidArgument without one.
absl::StatusOr<absl::Span<const std::string>> WordsAfterMap(const MapSourceFlags& flags);
absl::StatusOr<std::vector<double>> NumbersAfterMap(const MapSourceFlags& flags);
// Requires an even number of numbers.
std::vector<Eigen::Vector2d> PointsOf(absl::Span<const double> numbers);

struct MapSource {
  std::unique_ptr<QueryableMap> map;
  int exit_status = 0;  // of a command that else succeeded: kFailed where the file is damaged
};
// Errors: those of ReadMapFile() and of MapClient::Connect().
absl::StatusOr<MapSource> OpenMapSource(const MapSourceFlags& flags);

// What rays and sweeps make of the surface.
struct ObstacleFlags {
  double occupied_log_odds = kDefaultOccupied;
  std::string unknown = "stops";

  UnknownPolicy Policy() const {
    return unknown == "passes" ? UnknownPolicy::kFree : UnknownPolicy::kBlocked;
  }
};
void AddOccupiedFlag(CLI::App& command, double& occupied_log_odds);
void AddObstacleFlags(CLI::App& command, ObstacleFlags& flags);
const char* NameOf(Occupancy occupancy);

}  // namespace splinemap
