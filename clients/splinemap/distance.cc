#include <CLI/App.hpp>
#include <memory>
#include <string>
#include <vector>

#include "clients/splinemap/answer_lines.h"
#include "clients/splinemap/commands.h"
#include "lib/base/status.h"
#include "splinemap/queryable_map.h"

namespace splinemap {
namespace {

struct DistanceFlags {
  LineFlags lines;
  double max_distance_m = 2;
  double occupied_log_odds = kDefaultOccupied;
};

absl::StatusOr<int> MeasureDistance(const DistanceFlags& flags) {
  LineAnswers answers;
  answers.row = "x_m,y_m";
  answers.columns = "distance_m,gradient_x,gradient_y,found";
  answers.invalid = "nan,nan,nan,0";
  answers.answer = [&](const QueryableMap& map, const std::vector<std::vector<double>>& rows)
      -> absl::StatusOr<std::vector<std::string>> {
    DistancesQuery query;
    query.max_distance_m = flags.max_distance_m;
    query.occupied_log_odds = flags.occupied_log_odds;
    for (const std::vector<double>& row : rows) query.points_m.emplace_back(row[0], row[1]);
    SPLINEMAP_ASSIGN_OR_RETURN(const DistancesQuery::Answer answer, map.Ask(query));
    std::vector<std::string> lines;
    for (const DistancesQuery::Distance& distance : answer.distances) {
      lines.push_back(fmt::format("{:.6f},{:.6f},{:.6f},{}", distance.distance_m,
                                  distance.gradient.x(), distance.gradient.y(),
                                  distance.distance_m < flags.max_distance_m ? 1 : 0));
    }
    return lines;
  };
  return AnswerLines(flags.lines, answers);
}

constexpr const char* kDistanceExamples = R"(
Examples:
  splinemap distance lab.splinemap 1.25 -0.4
  splinemap distance --live 1.25 -0.4 --max-distance 5
  splinemap distance lab.splinemap --points path.csv > clearances.csv

Prints the distance to the nearest occupied point, and its gradient, which points away from the
obstacle. Where none is nearer than --max-distance, "found" is 0 and the distance is that. Unknown
space is no obstacle: splinemap query tells what is known. --points reads lines x_m,y_m, ignores
further columns, and prints one line for each; a header yields a header. --live sends 10,000 lines
at a time.)";

}  // namespace

void AddDistance(CLI::App& app, Command& chosen) {
  auto flags = std::make_shared<DistanceFlags>();
  CLI::App* command = app.add_subcommand("distance", "Distance to the nearest obstacle");
  command->footer(kDistanceExamples);
  AddLineFlags(*command, "MAP X Y", "a point in metres", "--points", flags->lines);
  command->add_option("--max-distance", flags->max_distance_m,
                      "m, radius of the search (default 2)");
  AddOccupiedFlag(*command, flags->occupied_log_odds);
  command->callback([flags, &chosen] { chosen = [flags] { return MeasureDistance(*flags); }; });
}

}  // namespace splinemap
