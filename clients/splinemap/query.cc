#include <cmath>
#include <cstdio>
#include <fstream>
#include <iostream>
#include <limits>
#include <memory>
#include <optional>
#include <vector>

#include "absl/strings/ascii.h"
#include "absl/strings/numbers.h"
#include "absl/strings/str_split.h"
#include "clients/splinemap/commands.h"
#include "lib/base/status.h"
#include "lib/store/map_file.h"

namespace splinemap {
namespace {

constexpr const char* kColumns = "x_m,y_m,log_odds,probability,dx_per_m,dy_per_m,known";

struct Point {
  double x_m;
  double y_m;
};

std::string Answer(const MapSnapshot& map, const Point& point) {
  const SurfaceSample sample = map.Evaluate(point.x_m, point.y_m);
  return fmt::format("{},{},{:.6f},{:.6f},{:.6f},{:.6f},{}", point.x_m, point.y_m, sample.log_odds,
                     Probability(sample.log_odds), sample.gradient_per_m.x(),
                     sample.gradient_per_m.y(), sample.known ? 1 : 0);
}

std::optional<Point> ParsePoint(const std::string& line) {
  const std::vector<std::string> words = absl::StrSplit(line, ',');
  Point point;
  if (words.size() < 2 || !absl::SimpleAtod(words[0], &point.x_m) ||
      !absl::SimpleAtod(words[1], &point.y_m)) {
    return std::nullopt;
  }
  return point;
}

// One line out per line in. A first line without numbers is taken for a header.
absl::Status AnswerFile(const MapSnapshot& map, const std::string& path) {
  std::ifstream file;
  if (path != "-") {
    file.open(path);
    if (!file) return NotFound("cannot read {}", path);
  }
  std::istream& in = path == "-" ? std::cin : file;
  std::string line;
  int64_t broken = 0;
  for (int64_t number = 1; std::getline(in, line); ++number) {
    if (const std::optional<Point> point = ParsePoint(line)) {
      fmt::print("{}\n", Answer(map, *point));
    } else if (number == 1) {
      fmt::print("{}\n", kColumns);
    } else {
      fmt::print("nan,nan,nan,nan,nan,nan,0\n");
      if (broken++ == 0) {
        fmt::print(stderr, "{}:{}: not x_m,y_m: {}\n", path, number, line.substr(0, 60));
      }
    }
  }
  if (broken > 0) return InvalidArgument("{} lines of {} could not be read", broken, path);
  return absl::OkStatus();
}

struct Flags {
  std::string map;
  std::vector<double> point;
  std::string points_path;
};

absl::StatusOr<int> Query(const Flags& flags) {
  if (flags.point.empty() == flags.points_path.empty()) {
    return InvalidArgument("give either X Y or --points FILE");
  }
  SPLINEMAP_ASSIGN_OR_RETURN(const LoadedMap loaded, ReadMapFile(flags.map));
  const int status = ReportDamages(loaded);
  if (!flags.points_path.empty()) {
    SPLINEMAP_RETURN_IF_ERROR(AnswerFile(*loaded.map, flags.points_path));
    return status;
  }
  fmt::print("{}\n{}\n", kColumns, Answer(*loaded.map, {flags.point[0], flags.point[1]}));
  return status;
}

constexpr const char* kExamples = R"(
Examples:
  splinemap query lab.splinemap 1.25 -0.4
  splinemap query lab.splinemap --points path.csv > path_with_log_odds.csv

Units: metres in the map frame; log_odds of occupied; its gradient per metre; known is 1 where the
nearest control point was touched by a measurement. --points takes lines x_m,y_m (more columns are
ignored), - for stdin, and answers each line with one line; a header is answered with a header.)";

}  // namespace

void AddQuery(CLI::App& app, Command& chosen) {
  auto flags = std::make_shared<Flags>();
  CLI::App* command = app.add_subcommand("query", "Value and gradient of a map at points");
  command->footer(kExamples);
  command->add_option("MAP", flags->map, "Map file")->required();
  command->add_option("X_Y", flags->point, "Coordinates in metres")->expected(2);
  command->add_option("--points", flags->points_path, "CSV file of points")->type_name("FILE");
  command->callback([flags, &chosen] { chosen = [flags] { return Query(*flags); }; });
}

}  // namespace splinemap
