#include <cmath>
#include <memory>
#include <string>
#include <vector>

#include "clients/splinemap/answer_lines.h"
#include "clients/splinemap/commands.h"
#include "lib/base/status.h"

namespace splinemap {
namespace {

struct RayFlags {
  MapSourceFlags asked;
  ObstacleFlags obstacles;
  std::string rays_path;
  double max_range_m = 30;
};

absl::StatusOr<int> CastRays(const RayFlags& flags) {
  LineAnswers answers;
  answers.row = "x_m,y_m,bearing_deg";
  answers.columns = "occupancy,range_m";
  answers.broken = "unknown,nan";
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
  return AnswerLines(flags.asked, flags.rays_path, "--rays", answers);
}

constexpr const char* kRayExamples = R"(
Examples:
  splinemap ray lab.splinemap 1.25 -0.4 90
  splinemap ray --live 1.25 -0.4 -45 --max-range 10 --unknown passes
  splinemap ray lab.splinemap --rays rays.csv > ranges.csv

Prints what ends the ray, and where: occupied or unknown; free after --max-range. Bearings are in
degrees, counter-clockwise from the x axis of the map frame. --rays takes lines x_m,y_m,bearing_deg
(more columns are ignored), - for stdin, and answers each line with one line, with --live 10,000
at a time; a header is answered with a header.)";

}  // namespace

void AddRay(CLI::App& app, Command& chosen) {
  auto flags = std::make_shared<RayFlags>();
  CLI::App* command = app.add_subcommand("ray", "The range along a ray to what is occupied");
  command->footer(kRayExamples);
  AddAskedMapFlags(*command, "MAP_X_Y_BEARING", "origin in metres, bearing in degrees",
                   flags->asked);
  command->add_option("--rays", flags->rays_path, "CSV file of rays")->type_name("FILE");
  command->add_option("--max-range", flags->max_range_m, "Metres at most (default 30)");
  AddObstacleFlags(*command, flags->obstacles);
  command->callback([flags, &chosen] { chosen = [flags] { return CastRays(*flags); }; });
}

}  // namespace splinemap
