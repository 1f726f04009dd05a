#pragma once

#include <fmt/format.h>

#include <fstream>
#include <string>
#include <vector>

namespace splinemap {

// A CSV file that is also printed, row by row as it grows.
class Table {
 public:
  Table(const std::string& path, const std::vector<std::string>& columns) : file_(path) {
    fmt::print("\n{}\n", path);
    Write(columns);
  }

  template <typename... Values>
  void Row(const Values&... values) {
    Write({Text(values)...});
  }

 private:
  static std::string Text(const std::string& text) { return text; }
  static std::string Text(int64_t value) { return std::to_string(value); }
  static std::string Text(int value) { return std::to_string(value); }
  static std::string Text(double value) { return fmt::format("{:.5g}", value); }

  void Write(const std::vector<std::string>& fields) {
    for (const std::string& field : fields) fmt::print("{:<24} ", field);
    fmt::print("\n");
    std::fflush(stdout);
    file_ << fmt::format("{}\n", fmt::join(fields, ",")) << std::flush;
  }

  std::ofstream file_;
};

}  // namespace splinemap
