// What maps are worth that were summed from the layers of several robots, by ways to sum them.
// Writes one CSV file per table.
#include <CLI/CLI.hpp>
#include <filesystem>
#include <string>
#include <vector>

#include "tests/bench/accuracy/drives.h"
#include "tests/bench/layers/door_votes.h"
#include "tests/bench/layers/split_drives.h"

int main(int argc, char** argv) {
  CLI::App app("Merged maps of several robots by ways to merge them, as CSV tables");
  std::string out = "layers";
  std::string only;
  bool quick = false;
  app.add_option("--out", out, "Directory for the tables")->capture_default_str();
  app.add_option("--only", only, "One of door_votes, split_drives");
  app.add_flag("--quick", quick, "A smoke run of a few seconds; its figures mean nothing");
  CLI11_PARSE(app, argc, argv);
  std::filesystem::create_directories(out);
  using namespace splinemap;
  const DoorEffort door = quick ? DoorEffort{5, 5} : DoorEffort{};
  const std::vector<size_t> robots =
      quick ? std::vector<size_t>{1, 3} : std::vector<size_t>{1, 2, 5, 20};
  if (only != "split_drives") WriteDoorVotes(door, out);
  if (only != "door_votes") {
    WriteSplitDrives(ReadDrives(quick ? Effort::Quick() : Effort{}), robots, out);
  }
}
