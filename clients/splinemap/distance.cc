#include <memory>
#include <string>
#include <vector>

#include "clients/splinemap/answer_lines.h"
#include "clients/splinemap/commands.h"
#include "lib/base/status.h"

namespace splinemap {
namespace {

struct DistanceFlags {
  MapSourceFlags asked;
  std::string points_path;
  double max_distance_m = 2;
  double occupied_log_odds = kDefaultOccupied;
};

absl::StatusOr<int> MeasureDistance(const DistanceFlags& flags) {
  LineAnswers answers;
  answers.row = "x_m,y_m";
  answers.columns = "distance_m,gradient_x,gradient_y";
  answers.broken = "nan,nan,nan";
  answers.answer = [&](const QueryableMap& map, const std::vector<std::vector<double>>& rows)
      -> absl::StatusOr<std::vector<std::string>> {
    DistancesQuery query;
    query.max_distance_m = flags.max_distance_m;
    query.occupied_log_odds = flags.occupied_log_odds;
    for (const std::vector<double>& row : rows) query.points_m.emplace_back(row[0], row[1]);
    SPLINEMAP_ASSIGN_OR_RETURN(const DistancesQuery::Answer answer, map.Ask(query));
    std::vector<std::string> lines;
    for (const DistancesQuery::Distance& distance : answer.distances) {
      lines.push_back(fmt::format("{:.6f},{:.6f},{:.6f}", distance.distance_m,
                                  distance.gradient.x(), distance.gradient.y()));
    }
    return lines;
  };
  return AnswerLines(flags.asked, flags.points_path, "--points", answers);
}

constexpr const char* kDistanceExamples = R"(
Examples:
  splinemap distance lab.splinemap 1.25 -0.4
  splinemap distance --live 1.25 -0.4 --max-distance 5
  splinemap distance lab.splinemap --points path.csv > clearances.csv

Prints how far the nearest occupied point is, --max-distance where none is nearer, and the gradient
of that, which points away from it. --points takes lines x_m,y_m (more columns are ignored), - for
stdin, and answers each line with one line, with --live 10,000 at a time; a header is answered with
a header.)";

}  // namespace

void AddDistance(CLI::App& app, Command& chosen) {
  auto flags = std::make_shared<DistanceFlags>();
  CLI::App* command = app.add_subcommand("distance", "How far the nearest occupied point is");
  command->footer(kDistanceExamples);
  AddAskedMapFlags(*command, "MAP_X_Y", "coordinates in metres", flags->asked);
  command->add_option("--points", flags->points_path, "CSV file of points")->type_name("FILE");
  command->add_option("--max-distance", flags->max_distance_m, "Metres at most (default 2)");
  AddOccupiedFlag(*command, flags->occupied_log_odds);
  command->callback([flags, &chosen] { chosen = [flags] { return MeasureDistance(*flags); }; });
}

}  // namespace splinemap
