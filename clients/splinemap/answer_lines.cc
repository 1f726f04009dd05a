#include "clients/splinemap/answer_lines.h"

#include <CLI/App.hpp>
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <fstream>
#include <iostream>
#include <nlohmann/json.hpp>
#include <optional>

#include "absl/strings/ascii.h"
#include "absl/strings/numbers.h"
#include "absl/strings/str_split.h"
#include "clients/splinemap/print.h"
#include "lib/base/plain_text.h"
#include "lib/base/status.h"
#include "splinemap/queryable_map.h"

namespace splinemap {
namespace {

using Row = std::vector<double>;

size_t NumColumns(const LineAnswers& answers) {
  return 1 + std::count(answers.row.begin(), answers.row.end(), ',');
}

// Separated by semicolons, else commas, else spaces or tabs.
std::vector<std::string> WordsOf(const std::string& line) {
  std::vector<std::string> words;
  const bool has_separator = line.find_first_of(";,") != std::string::npos;
  if (has_separator) {
    words = absl::StrSplit(line, line.find(';') != std::string::npos ? ';' : ',');
  } else {
    words = absl::StrSplit(line, absl::ByAnyChar(" \t\r"), absl::SkipEmpty());
  }
  for (std::string& word : words) absl::StripAsciiWhitespace(&word);
  return words;
}

// Whether it names columns: no word of it is a number.
bool IsHeader(const std::string& line) {
  double number = 0;
  for (const std::string& word : WordsOf(line)) {
    if (absl::SimpleAtod(word, &number)) return false;
  }
  return true;
}

// More columns are ignored.
std::optional<Row> ParseRow(const std::string& line, const LineAnswers& answers) {
  const std::vector<std::string> words = WordsOf(line);
  Row row(NumColumns(answers));
  if (words.size() < row.size()) return std::nullopt;
  for (size_t k = 0; k < row.size(); ++k) {
    if (!absl::SimpleAtod(words[k], &row[k])) return std::nullopt;
    if (answers.finite && !std::isfinite(row[k])) return std::nullopt;
  }
  return row;
}

nlohmann::json ToJsonValue(const std::string& word) {
  double number = 0;
  if (!absl::SimpleAtod(word, &number)) return word;
  return std::isfinite(number) ? nlohmann::json(number) : nlohmann::json();
}

absl::Status AnswerBatch(const QueryableMap& map, const LineAnswers& answers, bool json,
                         std::vector<std::optional<Row>>& batch) {
  std::vector<Row> rows;
  for (const std::optional<Row>& row : batch) {
    if (row) rows.push_back(*row);
  }
  SPLINEMAP_ASSIGN_OR_RETURN(const std::vector<std::string> lines, answers.answer(map, rows));
  auto next = lines.begin();
  for (const std::optional<Row>& row : batch) {
    PrintAnswer(answers.columns, row ? *next++ : answers.invalid, json);
  }
  batch.clear();
  return absl::OkStatus();
}

absl::Status AnswerFile(const QueryableMap& map, const LineFlags& flags,
                        const LineAnswers& answers) {
  std::ifstream file;
  if (flags.path != "-") {
    file.open(flags.path);
    if (!file) return NotFound("cannot read {}", flags.path);
  }
  // Over the bus an answer takes a round trip; here each line is answered when it comes.
  const size_t batch_size = flags.source.IsFile() ? 1 : 10'000;
  std::istream& in = flags.path == "-" ? std::cin : file;
  std::string line;
  std::vector<std::optional<Row>> batch;
  int64_t invalid = 0;
  for (int64_t number = 1; std::getline(in, line); ++number) {
    if (number == 1) line = std::string(WithoutByteOrderMark(line));
    std::optional<Row> row = ParseRow(line, answers);
    if (number == 1 && !row && IsHeader(line)) {
      if (!flags.json) fmt::print("{}\n", answers.columns);
      continue;
    }
    if (!row && invalid++ == 0) {
      PrintLine(stderr, "{}:{}: not {}: {}", flags.path, number, answers.row, line.substr(0, 60));
    }
    batch.push_back(std::move(row));
    if (batch.size() < batch_size) continue;
    SPLINEMAP_RETURN_IF_ERROR(AnswerBatch(map, answers, flags.json, batch));
  }
  if (!batch.empty()) {
    SPLINEMAP_RETURN_IF_ERROR(AnswerBatch(map, answers, flags.json, batch));
  }
  if (invalid > 0) return InvalidArgument("{} lines of {} could not be read", invalid, flags.path);
  return absl::OkStatus();
}

}  // namespace

void AddLineFlags(CLI::App& command, const std::string& names, const std::string& what,
                  const std::string& path_flag, LineFlags& flags) {
  AddMapSource(command, names, what, flags.source);
  flags.numbers = names.substr(names.find(' ') + 1);
  flags.path_flag = path_flag;
  command.add_option(path_flag, flags.path, "CSV file of " + path_flag.substr(2) + ", - for stdin")
      ->type_name("FILE");
  AddJsonFlag(command, flags.json);
}

void PrintAnswer(const std::string& columns, const std::string& line, bool json) {
  if (!json) {
    fmt::print("{}\n", line);
    return;
  }
  const std::vector<std::string> names = absl::StrSplit(columns, ',');
  const std::vector<std::string> words = absl::StrSplit(line, ',');
  nlohmann::json object;
  for (size_t k = 0; k < names.size(); ++k) object[names[k]] = ToJsonValue(words.at(k));
  PrintJson(object, -1);
}

absl::StatusOr<int> AnswerLines(const LineFlags& flags, const LineAnswers& answers) {
  SPLINEMAP_ASSIGN_OR_RETURN(const Row numbers, NumbersAfterMap(flags.source));
  if (numbers.size() != (flags.path.empty() ? NumColumns(answers) : 0)) {
    return InvalidArgument("give {}, or {} FILE in their place", flags.numbers, flags.path_flag);
  }
  SPLINEMAP_ASSIGN_OR_RETURN(const MapSource source, OpenMapSource(flags.source));
  if (!flags.path.empty()) {
    SPLINEMAP_RETURN_IF_ERROR(AnswerFile(*source.map, flags, answers));
    return source.exit_status;
  }
  SPLINEMAP_ASSIGN_OR_RETURN(const auto lines, answers.answer(*source.map, {numbers}));
  if (!flags.json) fmt::print("{}\n", answers.columns);
  PrintAnswer(answers.columns, lines.at(0), flags.json);
  return source.exit_status;
}

}  // namespace splinemap
