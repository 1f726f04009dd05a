#pragma once

#include <CLI/App.hpp>
#include <Eigen/Core>
#include <memory>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "absl/types/span.h"
#include "clients/client/map_client.h"
#include "lib/query/queryable_map.h"

namespace splinemap {

// What commands share that ask a map file or, with --live, the map of a daemon.
struct AskedMapFlags {
  std::vector<std::string> words;  // a map file unless `live`, and what the command takes
  bool live = false;
  std::string lcm_url;
  ClientOptions client;
  double timeout_s = 2;
};

// `words` is how --help calls the words of the command, `what` explains them.
void AddAskedMapFlags(CLI::App& command, const std::string& words, const std::string& what,
                      AskedMapFlags& flags);

// The words after the map file. InvalidArgument without one.
absl::StatusOr<absl::Span<const std::string>> WordsAfterMap(const AskedMapFlags& flags);
absl::StatusOr<std::vector<double>> NumbersAfterMap(const AskedMapFlags& flags);
// Requires an even number of numbers.
std::vector<Eigen::Vector2d> PointsOf(absl::Span<const double> numbers);

struct AskedMap {
  std::unique_ptr<QueryableMap> map;
  int exit_status = 0;  // of a command that else succeeded: kFailed where the file is damaged
};
// Errors: those of ReadMapFile() and of MapClient::Connect().
absl::StatusOr<AskedMap> OpenAskedMap(const AskedMapFlags& flags);

// What rays and sweeps make of the surface.
struct ObstacleFlags {
  double occupied_log_odds = kEvenLogOdds;
  std::string unknown = "stops";

  Unknown UnknownPolicy() const { return unknown == "passes" ? Unknown::kPasses : Unknown::kStops; }
};
void AddOccupiedFlag(CLI::App& command, double& occupied_log_odds);
void AddObstacleFlags(CLI::App& command, ObstacleFlags& flags);
const char* NameOf(Occupancy occupancy);

}  // namespace splinemap
