#pragma once

#include <Eigen/Core>
#include <memory>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "absl/types/span.h"
#include "clients/splinemap/bus_flags.h"
#include "lib/fleet/fleet_address.h"
#include "splinemap/layer_set.h"
#include "splinemap/queries.h"

namespace CLI {
class App;
}

namespace splinemap {

class QueryableMap;
struct MapView;

// Where a command reads the map: a map file, its first positional, or with --live a bus, or with
// --fleet a fleet.
struct MapSourceFlags {
  std::vector<std::string> arguments;  // all positionals: the map file if there is one, and others
  bool live = false;
  BusFlags bus;  // its timeout also of a fleet
  FleetAddress fleet;
  std::string robot;  // empty: any
  std::string at;     // a time, of a map file

  bool IsFleet() const { return !fleet.servers.empty(); }
  bool IsFile() const { return !live && !IsFleet(); }
  // As on the command line: the file, or the flags that take its place.
  std::string Text() const;
};

// Adds the positionals of a command, which --help calls `names`, beginning with MAP, --live with
// the flags of the daemon that is queried, and --fleet. `what` explains the positionals after MAP.
void AddMapSource(CLI::App& command, const std::string& names, const std::string& what,
                  MapSourceFlags& flags);
// The same for commands that evaluate the map themselves, for which --live follows the daemons, and
// --fleet the layers.
void AddMapViewSource(CLI::App& command, const std::string& names, const std::string& what,
                      MapSourceFlags& flags);

// The map file, as a list that has it if there is one.
std::vector<std::string> MapFilesOf(const MapSourceFlags& flags);
// The positionals after the map file. InvalidArgument without one.
absl::StatusOr<absl::Span<const std::string>> ArgumentsAfterMap(const MapSourceFlags& flags);
absl::StatusOr<std::vector<double>> NumbersAfterMap(const MapSourceFlags& flags);
// The one positional after the map file, which names what to write.
absl::StatusOr<std::string> OutputAfterMap(const MapSourceFlags& flags);
// Requires an even number of numbers.
std::vector<Eigen::Vector2d> PointsOf(absl::Span<const double> numbers);

// Both require ArgumentsAfterMap(). `exit_status` is that of a command that else succeeded: kFailed
// where the file is corrupt.
struct MapSource {
  std::unique_ptr<QueryableMap> map;
  int exit_status = 0;
};
// Errors: those of ReadMapFile(), of MapClient::Connect() and of FollowWholeFleet().
absl::StatusOr<MapSource> OpenMapSource(const MapSourceFlags& flags);
struct MapViewSource {
  LayerSet layers;
  std::shared_ptr<const MapView> map;  // their sum
  int exit_status = 0;
};
// Errors: those of ReadMapFile(), of FollowUntilCaughtUp() and of FollowWholeFleet().
absl::StatusOr<MapViewSource> OpenMapView(const MapSourceFlags& flags);

// What blocks rays and sweeps.
struct ObstacleFlags {
  double occupied_log_odds = kDefaultOccupied;
  std::string unknown = "blocked";

  UnknownPolicy Policy() const {
    return unknown == "free" ? UnknownPolicy::kFree : UnknownPolicy::kBlocked;
  }
};
void AddOccupiedFlag(CLI::App& command, double& occupied_log_odds);
void AddObstacleFlags(CLI::App& command, ObstacleFlags& flags);
const char* NameOf(Occupancy occupancy);

}  // namespace splinemap
