#include <memory>
#include <vector>

#include "clients/splinemap/commands.h"
#include "clients/splinemap/map_source.h"
#include "lib/base/status.h"

namespace splinemap {
namespace {

struct CheckFlags {
  MapSourceFlags asked;
  ObstacleFlags obstacles;
  double radius_m = 0;
};

absl::StatusOr<int> CheckPath(const CheckFlags& flags) {
  SPLINEMAP_ASSIGN_OR_RETURN(const std::vector<double> numbers, NumbersAfterMap(flags.asked));
  if (numbers.empty() || numbers.size() % 2 != 0) {
    return InvalidArgument("give the path as X0 Y0 X1 Y1 ..; there are {} numbers", numbers.size());
  }
  SweepsQuery query;
  query.sweeps.push_back({PointsOf(numbers), flags.radius_m});
  query.occupied_log_odds = flags.obstacles.occupied_log_odds;
  query.unknown = flags.obstacles.Policy();
  SPLINEMAP_ASSIGN_OR_RETURN(const MapSource asked, OpenMapSource(flags.asked));
  SPLINEMAP_ASSIGN_OR_RETURN(const SweepsQuery::Answer answer, asked.map->Ask(query));
  const SweepsQuery::Result& result = answer.results.at(0);
  fmt::print("occupancy,certified,free_m,contact_x_m,contact_y_m\n{},{},{:.6f},{:.6f},{:.6f}\n",
             NameOf(result.occupancy), result.is_certified ? 1 : 0, result.free_m,
             result.contact_m.x(), result.contact_m.y());
  return result.occupancy == Occupancy::kFree ? asked.exit_status : kFailed;
}

constexpr const char* kCheckExamples = R"(
Examples:
  splinemap check lab.splinemap 0 0 2.5 -1 4 -1 --radius 0.3
  splinemap check --live 0 0 2.5 -1 --radius 0.3 --unknown passes && echo free

Whether a disc can go along the path through these points, or stand at one. Prints what it touches
first, whether that is certain from bounds of the surface alone, how much of the path is free, and a
point of contact (0 where free). Exit status: 0 free, 1 not free or not answered (then nothing is on
stdout), 2 usage.)";

}  // namespace

void AddCheck(CLI::App& app, Command& chosen) {
  auto flags = std::make_shared<CheckFlags>();
  CLI::App* command = app.add_subcommand("check", "Whether a disc can go along a path");
  command->footer(kCheckExamples);
  AddAskedMapFlags(*command, "MAP_X0_Y0_X1_Y1", "points of the path in metres", flags->asked);
  command->add_option("--radius", flags->radius_m, "Of the disc, in metres")->required();
  AddObstacleFlags(*command, flags->obstacles);
  command->callback([flags, &chosen] { chosen = [flags] { return CheckPath(*flags); }; });
}

}  // namespace splinemap
