#include <CLI/App.hpp>
#include <memory>
#include <vector>

#include "clients/splinemap/answer_lines.h"
#include "clients/splinemap/commands.h"
#include "clients/splinemap/print.h"
#include "lib/base/status.h"
#include "splinemap/queryable_map.h"

namespace splinemap {
namespace {

struct CheckFlags {
  MapSourceFlags source;
  ObstacleFlags obstacles;
  double radius_m = 0;
  bool json = false;
};

absl::StatusOr<int> CheckPath(const CheckFlags& flags) {
  SPLINEMAP_ASSIGN_OR_RETURN(const std::vector<double> numbers, NumbersAfterMap(flags.source));
  if (numbers.empty() || numbers.size() % 2 != 0) {
    return InvalidArgument("give the path as X0 Y0 X1 Y1 ..; there are {} numbers", numbers.size());
  }
  SweepsQuery query;
  query.sweeps.push_back({PointsOf(numbers), flags.radius_m});
  query.occupied_log_odds = flags.obstacles.occupied_log_odds;
  query.unknown = flags.obstacles.Policy();
  SPLINEMAP_ASSIGN_OR_RETURN(const MapSource source, OpenMapSource(flags.source));
  SPLINEMAP_ASSIGN_OR_RETURN(const SweepsQuery::Answer answer, source.map->Ask(query));
  const SweepsQuery::Result& result = answer.results.at(0);
  constexpr const char* kColumns = "occupancy,certified,free_m,contact_x_m,contact_y_m";
  if (!flags.json) fmt::print("{}\n", kColumns);
  const bool is_free = result.occupancy == Occupancy::kFree;
  const std::string contact =
      is_free ? "nan,nan"
              : fmt::format("{:.6f},{:.6f}", result.contact_m.x(), result.contact_m.y());
  PrintAnswer(kColumns,
              fmt::format("{},{},{:.6f},{}", NameOf(result.occupancy), result.is_certified ? 1 : 0,
                          result.free_m, contact),
              flags.json);
  return is_free ? source.exit_status : kFailed;
}

constexpr const char* kCheckExamples = R"(
Examples:
  splinemap check lab.splinemap 0 0 2.5 -1 4 -1 --radius 0.3
  splinemap check --live 0 0 2.5 -1 --radius 0.3 --unknown free && echo free

Checks whether a disc can move along the path through these points, or stand at one point. Prints
what it touches first, whether bounds of the surface alone prove that (certified), the length of
path that is free, and a point of contact (nan where free). Exit status: 0 free; 1 not free, or
failed and nothing is on stdout; 2 usage.)";

}  // namespace

void AddCheck(CLI::App& app, Command& chosen) {
  auto flags = std::make_shared<CheckFlags>();
  CLI::App* command = app.add_subcommand("check", "Check whether a disc can move along a path");
  command->footer(kCheckExamples);
  AddMapSource(*command, "MAP X0 Y0 X1 Y1", "the points of the path in metres", flags->source);
  command->add_option("--radius", flags->radius_m, "m, radius of the disc")->required();
  AddObstacleFlags(*command, flags->obstacles);
  AddJsonFlag(*command, flags->json);
  command->callback([flags, &chosen] { chosen = [flags] { return CheckPath(*flags); }; });
}

}  // namespace splinemap
