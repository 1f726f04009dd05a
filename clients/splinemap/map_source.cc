#include "clients/splinemap/map_source.h"

#include <CLI/App.hpp>
#include <chrono>
#include <cmath>
#include <thread>

#include "absl/strings/numbers.h"
#include "clients/splinemap/commands.h"
#include "clients/splinemap/files.h"
#include "clients/splinemap/follow.h"
#include "clients/splinemap/follow_fleet.h"
#include "clients/splinemap/print.h"
#include "clients/splinemap/refold.h"
#include "clients/splinemap/time_flag.h"
#include "lib/base/status.h"
#include "lib/fleet/fleet_map.h"
#include "lib/fleet/fleet_flags.h"
#include "lib/map/summed_layers.h"
#include "splinemap/client.h"
#include "splinemap/file.h"
#include "splinemap/local_map.h"

namespace splinemap {
namespace {

struct SourceOptions {
  CLI::Option* live;
  CLI::Option* fleet;
  CLI::Option* robot;
};

// For flags of a bus that are of a fleet, too.
void RequireLiveOrFleet(CLI::App& command, const SourceOptions& source,
                        const std::vector<CLI::Option*>& options) {
  for (CLI::Option* option : options) option->group("With --live or --fleet");
  command.parse_complete_callback([source, options] {
    if (source.live->count() + source.fleet->count() > 0) return;
    for (const CLI::Option* option : options) {
      if (option->count() > 0) throw CLI::RequiresError(option->get_name(), "--live or --fleet");
    }
  });
}

SourceOptions AddSource(CLI::App& command, const std::string& names, const std::string& what,
                        const std::string& robot, MapSourceFlags& flags) {
  command.add_option(names, flags.arguments,
                     "Map file, --live or --fleet" + (what.empty() ? "" : "; then " + what));
  SourceOptions options{};
  options.live = command.add_flag("--live", flags.live, "Use the map of the daemons on an LCM bus");
  options.fleet = AddFleetFlags(command, flags.fleet)->excludes(options.live);
  AddBusFlags(command, flags.bus, options.live);
  options.robot = command.add_option("--robot", flags.robot, robot)->type_name("NAME");
  command
      .add_option("--at", flags.at, std::string("The map of a file as it was then; ") + kTimeHelp)
      ->type_name("TIME")
      ->excludes(options.live, options.fleet);
  return options;
}

// With the map as it was at the time of the flags.
absl::StatusOr<LoadedMap> ReadSource(const MapSourceFlags& flags) {
  SPLINEMAP_ASSIGN_OR_RETURN(LoadedMap loaded, ReadMapFile(flags.arguments.at(0)));
  if (!flags.at.empty()) SPLINEMAP_RETURN_IF_ERROR(WindBack(loaded.set, flags.at));
  return loaded;
}

}  // namespace

void AddMapSource(CLI::App& command, const std::string& names, const std::string& what,
                  MapSourceFlags& flags) {
  const SourceOptions source =
      AddSource(command, names, what, "Only the daemon of this robot", flags);
  RequireLive(source.robot, source.live);
  RequireLiveOrFleet(command, source, {AddTimeoutFlag(command, flags.bus)});
}

void AddMapViewSource(CLI::App& command, const std::string& names, const std::string& what,
                      MapSourceFlags& flags) {
  flags.bus.timeout_s = kCatchUpTimeout_s;
  const SourceOptions source = AddSource(command, names, what, kLayersOfRobot, flags);
  RequireLiveOrFleet(command, source, {source.robot, AddTimeoutFlag(command, flags.bus)});
}

std::string MapSourceFlags::Text() const {
  if (live) return "--live";
  if (!IsFleet()) return arguments.empty() ? "" : arguments.front();
  const bool is_default = fleet.map == FleetAddress().map;
  return fmt::format("--fleet {}{}{}", fleet.servers, is_default ? "" : " --fleet-map ",
                     is_default ? "" : fleet.map);
}

std::vector<std::string> MapFilesOf(const MapSourceFlags& flags) {
  if (!flags.IsFile() || flags.arguments.empty()) return {};
  return {flags.arguments.front()};
}

absl::StatusOr<absl::Span<const std::string>> ArgumentsAfterMap(const MapSourceFlags& flags) {
  const absl::Span<const std::string> arguments = flags.arguments;
  if (!flags.IsFile()) return arguments;
  if (arguments.empty()) return InvalidArgument("give a map file, --live or --fleet");
  return arguments.subspan(1);
}

absl::StatusOr<std::vector<double>> NumbersAfterMap(const MapSourceFlags& flags) {
  SPLINEMAP_ASSIGN_OR_RETURN(const auto arguments, ArgumentsAfterMap(flags));
  std::vector<double> numbers;
  for (const std::string& argument : arguments) {
    double number = 0;
    if (!absl::SimpleAtod(argument, &number)) {
      return InvalidArgument("{} is not a number{}", argument,
                             flags.live        ? "; --live takes the place of the map file"
                             : flags.IsFleet() ? "; --fleet takes the place of the map file"
                             : argument.find(',') != std::string::npos
                                 ? "; numbers are separated by spaces"
                                 : "");
    }
    if (!std::isfinite(number)) return InvalidArgument("{} is no coordinate", argument);
    numbers.push_back(number);
  }
  return numbers;
}

absl::StatusOr<std::string> OutputAfterMap(const MapSourceFlags& flags) {
  SPLINEMAP_ASSIGN_OR_RETURN(const auto arguments, ArgumentsAfterMap(flags));
  if (arguments.size() != 1) {
    return InvalidArgument("give one output after {}; there are {}",
                           flags.live        ? "--live, which takes the place of the map file"
                           : flags.IsFleet() ? "--fleet, which takes the place of the map file"
                                             : "the map file",
                           arguments.size());
  }
  return arguments[0];
}

std::vector<Eigen::Vector2d> PointsOf(absl::Span<const double> numbers) {
  std::vector<Eigen::Vector2d> points;
  for (size_t k = 0; k < numbers.size(); k += 2) points.emplace_back(numbers[k], numbers[k + 1]);
  return points;
}

namespace {

void WarnOfOtherMaps(const MapClient& client) {
  constexpr std::chrono::milliseconds kOtherReplies(100);
  std::this_thread::sleep_for(kOtherReplies);
  const std::vector<std::string> robots = client.RobotsOfOtherMaps();
  if (robots.empty()) return;
  PrintLine(stderr, "the daemon of {} answers; {} have another map. Choose with --robot",
            PlainText(client.daemon().name), PlainText(fmt::format("{}", fmt::join(robots, ", "))));
}

absl::StatusOr<MapSource> OpenFleetMap(const MapSourceFlags& flags) {
  SPLINEMAP_ASSIGN_OR_RETURN(auto map, FleetMap::Connect(flags.fleet, flags.bus.Timeout()));
  return MapSource{std::move(map), kSuccess};
}

}  // namespace

absl::StatusOr<MapSource> OpenMapSource(const MapSourceFlags& flags) {
  if (flags.IsFleet()) return OpenFleetMap(flags);
  if (flags.live) {
    ClientOptions options;
    options.channel_prefix = flags.bus.channel_prefix;
    options.robot = flags.robot;
    SPLINEMAP_ASSIGN_OR_RETURN(options.keys, flags.bus.Keys());
    options.deadline = flags.bus.Timeout();
    SPLINEMAP_ASSIGN_OR_RETURN(auto client, MapClient::Connect(flags.bus.lcm_url, options));
    if (flags.robot.empty()) WarnOfOtherMaps(*client);
    return MapSource{std::move(client), kSuccess};
  }
  SPLINEMAP_ASSIGN_OR_RETURN(const LoadedMap loaded, ReadSource(flags));
  return MapSource{std::make_unique<LocalMap>(ViewOf(loaded.set)), ReportCorruption(loaded)};
}

absl::StatusOr<MapViewSource> OpenMapView(const MapSourceFlags& flags) {
  if (flags.live) {
    FollowOptions options;
    if (!flags.robot.empty()) options.names = {flags.robot};
    SPLINEMAP_ASSIGN_OR_RETURN(const auto replica, FollowUntilCaughtUp(flags.bus, options));
    LayerSet layers = replica->Layers();
    auto map = ViewOf(layers);
    return MapViewSource{std::move(layers), std::move(map), ReportRefused(replica->Refused())};
  }
  if (flags.IsFleet()) {
    FleetFollowOptions options;
    if (!flags.robot.empty()) options.names = {flags.robot};
    SPLINEMAP_ASSIGN_OR_RETURN(const FollowedFleet fleet,
                               FollowWholeFleet(flags.fleet, options, flags.bus.Timeout()));
    LayerSet layers = fleet.replica->WholeLayers();
    auto map = ViewOf(layers);
    return MapViewSource{std::move(layers), std::move(map),
                         ReportRefused(fleet.replica->Refused())};
  }
  SPLINEMAP_ASSIGN_OR_RETURN(LoadedMap loaded, ReadSource(flags));
  const int exit_status = ReportCorruption(loaded);
  auto map = ViewOf(loaded.set);
  return MapViewSource{std::move(loaded.set), std::move(map), exit_status};
}

void AddOccupiedFlag(CLI::App& command, double& occupied_log_odds) {
  command
      .add_option("--occupied", occupied_log_odds,
                  "A point of at least these log-odds is occupied (default 0)")
      ->type_name("LOG_ODDS");
}

void AddObstacleFlags(CLI::App& command, ObstacleFlags& flags) {
  AddOccupiedFlag(command, flags.occupied_log_odds);
  command
      .add_option("--unknown", flags.unknown,
                  "Whether unknown space is blocked or free (default blocked)")
      ->check(CLI::IsMember({"blocked", "free"}));
}

const char* NameOf(Occupancy occupancy) {
  return occupancy == Occupancy::kFree       ? "free"
         : occupancy == Occupancy::kOccupied ? "occupied"
                                             : "unknown";
}

}  // namespace splinemap
