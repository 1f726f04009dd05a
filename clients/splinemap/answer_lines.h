#pragma once

#include <functional>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "clients/splinemap/map_source.h"

namespace CLI {
class App;
}

namespace splinemap {

// What commands take that answer rows of numbers, from the command line or from a file.
struct LineFlags {
  MapSourceFlags source;
  std::string numbers;  // "X Y"
  std::string path_flag;
  std::string path;  // of a file of rows, - for stdin; empty: the row is on the command line
  bool json = false;
};
// Adds the map, the flag `path_flag` for a file, and --json. `names` and `what` as of AddMapSource.
void AddLineFlags(CLI::App& command, const std::string& names, const std::string& what,
                  const std::string& path_flag, LineFlags& flags);

// How a command answers rows of numbers with lines of CSV.
struct LineAnswers {
  std::string row;      // the columns of a row that it takes
  std::string columns;  // of an answer
  std::string invalid;  // the answer to a line that is not a row
  bool finite = true;   // whether rows of other numbers are invalid
  // One line a row, in their order.
  std::function<absl::StatusOr<std::vector<std::string>>(
      const QueryableMap&, const std::vector<std::vector<double>>& rows)>
      answer;
};

// Opens the map and prints the answers, one line per row. Returns the exit status.
absl::StatusOr<int> AnswerLines(const LineFlags& flags, const LineAnswers& answers);

// Prints an answer of CSV, with `json` as a JSON object on one line.
void PrintAnswer(const std::string& columns, const std::string& line, bool json);

}  // namespace splinemap
