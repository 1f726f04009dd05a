#pragma once

#include <Eigen/Core>
#include <functional>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "clients/splinemap/map_source.h"

namespace splinemap {

// How a command answers rows of numbers with lines of CSV.
struct LineAnswers {
  std::string row;      // the columns of a row that it takes
  std::string columns;  // of an answer
  std::string broken;   // the answer to a line that is no row
  bool finite = true;   // a row of other numbers is none
  // One line a row, in their order.
  std::function<absl::StatusOr<std::vector<std::string>>(
      const QueryableMap&, const std::vector<std::vector<double>>& rows)>
      answer;
};

// Opens the map and prints the answers to the numbers on the command line or, where `path` is not
// empty, one line per line of that file (- for stdin). Returns the exit status.
absl::StatusOr<int> AnswerLines(const MapSourceFlags& flags, const std::string& path,
                                const std::string& path_flag, const LineAnswers& answers);

}  // namespace splinemap
