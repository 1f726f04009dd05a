#include <CLI/App.hpp>
#include <cmath>
#include <memory>
#include <string>
#include <vector>

#include "clients/splinemap/answer_lines.h"
#include "clients/splinemap/commands.h"
#include "lib/base/status.h"
#include "splinemap/queryable_map.h"

namespace splinemap {
namespace {

struct RayFlags {
  LineFlags lines;
  ObstacleFlags obstacles;
  double max_range_m = 30;
};

absl::StatusOr<int> CastRays(const RayFlags& flags) {
  LineAnswers answers;
  answers.row = "x_m,y_m,bearing_deg";
  answers.columns = "occupancy,range_m";
  answers.invalid = "unknown,nan";
  answers.answer = [&](const QueryableMap& map, const std::vector<std::vector<double>>& rows)
      -> absl::StatusOr<std::vector<std::string>> {
    RaysQuery query;
    query.occupied_log_odds = flags.obstacles.occupied_log_odds;
    query.unknown = flags.obstacles.Policy();
    for (const std::vector<double>& row : rows) {
      query.rays.push_back({{row[0], row[1]}, row[2] * M_PI / 180, flags.max_range_m});
    }
    SPLINEMAP_ASSIGN_OR_RETURN(const RaysQuery::Answer answer, map.Ask(query));
    std::vector<std::string> lines;
    for (const RaysQuery::End& end : answer.ends) {
      lines.push_back(fmt::format("{},{:.6f}", NameOf(end.occupancy), end.range_m));
    }
    return lines;
  };
  return AnswerLines(flags.lines, answers);
}

constexpr const char* kRayExamples = R"(
Examples:
  splinemap ray lab.splinemap 1.25 -0.4 90
  splinemap ray --live 1.25 -0.4 -45 --max-range 10 --unknown free
  splinemap ray lab.splinemap --rays rays.csv > ranges.csv

Prints what ends the ray, occupied or unknown space, and its range; free where nothing ends it
within --max-range. Bearings are in degrees, counter-clockwise from the x axis of the map frame.
--rays reads lines x_m,y_m,bearing_deg, ignores further columns, and prints one line for each; a
header yields a header. --live sends 10,000 lines at a time.)";

}  // namespace

void AddRay(CLI::App& app, Command& chosen) {
  auto flags = std::make_shared<RayFlags>();
  CLI::App* command = app.add_subcommand("ray", "Range along a ray to the first obstacle");
  command->footer(kRayExamples);
  AddLineFlags(*command, "MAP X Y BEARING", "an origin in metres and a bearing in degrees",
               "--rays", flags->lines);
  command->add_option("--max-range", flags->max_range_m, "m, length of the ray (default 30)");
  AddObstacleFlags(*command, flags->obstacles);
  command->callback([flags, &chosen] { chosen = [flags] { return CastRays(*flags); }; });
}

}  // namespace splinemap
