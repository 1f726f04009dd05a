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

struct QueryFlags {
  LineFlags lines;
  bool hessian = false;
};

absl::StatusOr<int> Query(const QueryFlags& flags) {
  LineAnswers answers;
  answers.row = "x_m,y_m";
  answers.columns = "x_m,y_m,log_odds,probability,dx_per_m,dy_per_m,known";
  answers.invalid = "nan,nan,nan,nan,nan,nan,0";
  answers.finite = false;  // such points are not known
  if (flags.hessian) {
    answers.columns += ",dxx_per_m2,dxy_per_m2,dyy_per_m2";
    answers.invalid += ",nan,nan,nan";
  }
  answers.answer = [&](const QueryableMap& map, const std::vector<std::vector<double>>& rows)
      -> absl::StatusOr<std::vector<std::string>> {
    PointsQuery query;
    query.with_hessians = flags.hessian;
    for (const std::vector<double>& row : rows) query.points_m.emplace_back(row[0], row[1]);
    SPLINEMAP_ASSIGN_OR_RETURN(const PointsQuery::Answer answer, map.Ask(query));
    std::vector<std::string> lines;
    for (size_t k = 0; k < rows.size(); ++k) {
      const SurfaceSample& sample = answer.samples[k];
      lines.push_back(fmt::format("{},{},{:.6f},{:.6f},{:.6f},{:.6f},{}", rows[k][0], rows[k][1],
                                  sample.log_odds, Probability(sample.log_odds),
                                  sample.gradient_per_m.x(), sample.gradient_per_m.y(),
                                  sample.known ? 1 : 0));
      if (!flags.hessian) continue;
      const Eigen::Matrix2d& hessian = answer.hessians_per_m2[k];
      lines.back() +=
          fmt::format(",{:.6f},{:.6f},{:.6f}", hessian(0, 0), hessian(0, 1), hessian(1, 1));
    }
    return lines;
  };
  return AnswerLines(flags.lines, answers);
}

constexpr const char* kQueryExamples = R"(
Examples:
  splinemap query lab.splinemap 1.25 -0.4
  splinemap query --live 1.25 -0.4 --json
  splinemap query --fleet nats://hub-1,nats://hub-2 1.25 -0.4
  splinemap query lab.splinemap --points path.csv > path_with_log_odds.csv

Prints the log-odds of occupied, the probability, and the gradient of the log-odds per metre.
"known" is 1 where a measurement touched the nearest control point. --points reads lines x_m,y_m,
ignores further columns, and prints one line for each; a header yields a header. --live sends
10,000 lines at a time.)";

}  // namespace

void AddQuery(CLI::App& app, Command& chosen) {
  auto flags = std::make_shared<QueryFlags>();
  CLI::App* command = app.add_subcommand("query", "Value and gradient of a map at points");
  command->footer(kQueryExamples);
  AddLineFlags(*command, "MAP X Y", "a point in metres", "--points", flags->lines);
  command->add_flag("--hessian", flags->hessian, "Add the second derivatives, per square metre");
  command->callback([flags, &chosen] { chosen = [flags] { return Query(*flags); }; });
}

}  // namespace splinemap
