// How soon a daemon answers, and how soon followers have what it maps.
#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <cstdio>
#include <fstream>

#include "lib/base/status.h"
#include "tests/bench/serving/largest_requests.h"
#include "tests/bench/serving/latency.h"

namespace splinemap::bench {
namespace {

void Print(const Figures& figures) {
  fmt::print("\n{:<50}", figures.workload);
  for (const std::string& unit : figures.units) fmt::print("{:>20} {:>7}", unit, "ratio");
  fmt::print("\n");
  for (const auto& [name, values] : figures.competitors) {
    fmt::print("{:<50}", name);
    for (size_t k = 0; k < values.size(); ++k) {
      fmt::print("{:>20.2f} {:>7.2f}", values[k], values[k] / figures.competitors[0].values[k]);
    }
    fmt::print("\n");
  }
  std::fflush(stdout);
}

std::string Json(const Figures& figures) {
  std::string rows;
  for (const auto& [name, values] : figures.competitors) {
    for (size_t k = 0; k < values.size(); ++k) {
      rows += fmt::format(
          "{{\"workload\": \"{}\", \"competitor\": \"{}\", \"unit\": \"{}\", \"value\": {}}}\n",
          figures.workload, name, figures.units[k], values[k]);
    }
  }
  return rows;
}

absl::Status Run(bool quick, bool is_following, const std::string& json_path) {
  std::vector<Figures> all;
  if (!is_following) {
    SPLINEMAP_ASSIGN_OR_RETURN(all, MeasureAsking(quick ? 20 : 500));
    for (const Figures& figures : all) Print(figures);
    Print(all.emplace_back(MeasureLargestRequests(quick ? 10 : 100)));
  }
  SPLINEMAP_ASSIGN_OR_RETURN(all.emplace_back(), MeasureLatency(quick ? 20 : 400));
  Print(all.back());
  if (json_path.empty()) return absl::OkStatus();
  std::ofstream json(json_path);
  for (const Figures& figures : all) json << Json(figures);
  return json.flush() ? absl::OkStatus() : Unavailable("cannot write {}", json_path);
}

int Main(int argc, char** argv) {
  CLI::App app("serving: latency of asking and following a map; run it by deploy/own_bus.sh");
  bool quick = false;
  bool is_echo = false;
  bool is_following = false;
  std::string json_path;
  app.add_flag("--quick", quick, "A little of everything; the figures say nothing");
  app.add_flag("--following", is_following, "Only what is received by followers, not requests");
  app.add_flag("--echo", is_echo, "Only send back what comes, for another process");
  app.add_option("--json", json_path, "Also write a JSON object a line to this file");
  CLI11_PARSE(app, argc, argv);
  if (absl::Status status = is_echo ? Echo() : Run(quick, is_following, json_path); !status.ok()) {
    fmt::print(stderr, "serving: {}\n", ErrorText(status));
    return 1;
  }
  return 0;
}

}  // namespace
}  // namespace splinemap::bench

int main(int argc, char** argv) { return splinemap::bench::Main(argc, argv); }
