#include "clients/splinemap/answer_lines.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <fstream>
#include <iostream>
#include <optional>

#include "absl/strings/numbers.h"
#include "absl/strings/str_split.h"
#include "clients/splinemap/say.h"
#include "lib/base/status.h"

namespace splinemap {
namespace {

using Row = std::vector<double>;

size_t NumColumns(const LineAnswers& answers) {
  return 1 + std::count(answers.row.begin(), answers.row.end(), ',');
}

// More columns are ignored.
std::optional<Row> ParseRow(const std::string& line, const LineAnswers& answers) {
  const std::vector<std::string> words = absl::StrSplit(line, ',');
  Row row(NumColumns(answers));
  if (words.size() < row.size()) return std::nullopt;
  for (size_t k = 0; k < row.size(); ++k) {
    if (!absl::SimpleAtod(words[k], &row[k])) return std::nullopt;
    if (answers.finite && !std::isfinite(row[k])) return std::nullopt;
  }
  return row;
}

absl::Status AnswerBatch(const QueryableMap& map, const LineAnswers& answers,
                         std::vector<std::optional<Row>>& batch) {
  std::vector<Row> rows;
  for (const std::optional<Row>& row : batch) {
    if (row) rows.push_back(*row);
  }
  SPLINEMAP_ASSIGN_OR_RETURN(const std::vector<std::string> lines, answers.answer(map, rows));
  auto next = lines.begin();
  for (const std::optional<Row>& row : batch) fmt::print("{}\n", row ? *next++ : answers.broken);
  batch.clear();
  return absl::OkStatus();
}

// A first line without numbers is taken for a header.
absl::Status AnswerFile(const QueryableMap& map, size_t batch_size, const std::string& path,
                        const LineAnswers& answers) {
  std::ifstream file;
  if (path != "-") {
    file.open(path);
    if (!file) return NotFound("cannot read {}", path);
  }
  std::istream& in = path == "-" ? std::cin : file;
  std::string line;
  std::vector<std::optional<Row>> batch;
  int64_t broken = 0;
  for (int64_t number = 1; std::getline(in, line); ++number) {
    std::optional<Row> row = ParseRow(line, answers);
    if (number == 1 && !row) {
      fmt::print("{}\n", answers.columns);
      continue;
    }
    if (!row && broken++ == 0) {
      Say(stderr, "{}:{}: not {}: {}", path, number, answers.row, line.substr(0, 60));
    }
    batch.push_back(std::move(row));
    if (batch.size() == batch_size) SPLINEMAP_RETURN_IF_ERROR(AnswerBatch(map, answers, batch));
  }
  if (!batch.empty()) SPLINEMAP_RETURN_IF_ERROR(AnswerBatch(map, answers, batch));
  if (broken > 0) return InvalidArgument("{} lines of {} could not be read", broken, path);
  return absl::OkStatus();
}

}  // namespace

absl::StatusOr<int> AnswerLines(const MapSourceFlags& flags, const std::string& path,
                                const std::string& path_flag, const LineAnswers& answers) {
  SPLINEMAP_ASSIGN_OR_RETURN(const Row numbers, NumbersAfterMap(flags));
  if (numbers.size() != (path.empty() ? NumColumns(answers) : 0)) {
    return InvalidArgument("give either {} or {} FILE", answers.row, path_flag);
  }
  SPLINEMAP_ASSIGN_OR_RETURN(const MapSource asked, OpenMapSource(flags));
  if (!path.empty()) {
    // Over the bus an answer takes a round trip; here each line is answered when it comes.
    const size_t batch_size = flags.live ? 10'000 : 1;
    SPLINEMAP_RETURN_IF_ERROR(AnswerFile(*asked.map, batch_size, path, answers));
    return asked.exit_status;
  }
  SPLINEMAP_ASSIGN_OR_RETURN(const auto lines, answers.answer(*asked.map, {numbers}));
  fmt::print("{}\n{}\n", answers.columns, lines.at(0));
  return asked.exit_status;
}

}  // namespace splinemap
