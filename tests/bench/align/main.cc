// How often maps are aligned rightly, refused and aligned wrongly, beside a matcher of features.
// Writes halves.csv, stretches.csv and strangers.csv.
#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <array>
#include <ctime>
#include <filesystem>
#include <functional>
#include <numbers>
#include <random>
#include <string>
#include <vector>

#include "lib/base/status.h"
#include "lib/geometry/angle.h"
#include "lib/matching/align.h"
#include "tests/bench/accuracy/table.h"
#include "tests/bench/align/feature_matcher.h"
#include "tests/bench/align/pieces.h"

namespace splinemap {
namespace {

constexpr double kDegree_rad = std::numbers::pi / 180;
constexpr double kRight_m = 0.1;
constexpr double kRight_rad = kDegree_rad;

struct Effort {
  int transforms = 100;  // of the halves of each drive
  int stretches = 100;   // pairs of stretches of each drive
  int strangers = 1000;  // pairs of different buildings
};

struct Aligner {
  std::string name;
  std::function<std::optional<Pose2>(const MapView& a, const MapView& b)> align;
};

std::vector<Aligner> Aligners() {
  return {{"splinemap",
           [](const MapView& a, const MapView& b) -> std::optional<Pose2> {
             const absl::StatusOr<Alignment> found = Align(a, b);
             if (!found.ok()) {
               fmt::print(stderr, "{}\n", ErrorText(found.status()));
               return std::nullopt;
             }
             return found->a_T_b;
           }},
          {"AKAZE", AlignByFeatures}};
}

struct Tally {
  int right = 0;
  int refused = 0;
  int wrong = 0;
  std::vector<double> errors_m;  // of those that are right
  std::vector<double> errors_deg;
  double time_s = 0;
  double longest_s = 0;
};

double MedianOf(std::vector<double> values) {
  if (values.empty()) return 0;
  std::nth_element(values.begin(), values.begin() + values.size() / 2, values.end());
  return values[values.size() / 2];
}

std::optional<Pose2> TimedAlign(const Aligner& aligner, const MapView& a, const MapView& b,
                                Tally& tally) {
  const std::clock_t start = std::clock();  // others may be busy
  std::optional<Pose2> found = aligner.align(a, b);
  const double took_s = static_cast<double>(std::clock() - start) / CLOCKS_PER_SEC;
  tally.time_s += took_s;
  tally.longest_s = std::max(tally.longest_s, took_s);
  return found;
}

Pose2 AnyPose(std::mt19937_64& random) {
  std::uniform_real_distribution<double> shift_m(-50, 50);
  std::uniform_real_distribution<double> yaw_rad(-std::numbers::pi, std::numbers::pi);
  const double x_m = shift_m(random);
  const double y_m = shift_m(random);
  return {{x_m, y_m}, yaw_rad(random)};
}

void Judge(const std::optional<Pose2>& found, const Pose2& b_T_world,
           const Eigen::Vector2d& middle_m, Tally& tally) {
  if (!found) {
    ++tally.refused;
    return;
  }
  const Pose2 off = *found * b_T_world;
  const double error_m = (off * middle_m - middle_m).norm();
  const double error_rad = std::abs(WrapAngle(off.yaw_rad));
  if (error_m > kRight_m || error_rad > kRight_rad) {
    ++tally.wrong;
    fmt::print(stderr, "off by {:.2f} m and {:.2f} degrees\n", error_m, error_rad / kDegree_rad);
    return;
  }
  ++tally.right;
  tally.errors_m.push_back(error_m);
  tally.errors_deg.push_back(error_rad / kDegree_rad);
}

void WriteTally(const std::string& of, double shared, const std::string& aligner,
                const Tally& tally, Table& table) {
  const int pairs = tally.right + tally.refused + tally.wrong;
  table.Row(of, shared, aligner, pairs, tally.right, tally.refused, tally.wrong,
            MedianOf(tally.errors_m), MedianOf(tally.errors_deg), tally.time_s / pairs,
            tally.longest_s);
}

Table TableOfTallies(const std::string& path) {
  return Table(path, {"drive", "shared", "aligner", "pairs", "right", "refused", "wrong",
                      "median_error_m", "median_error_deg", "mean_s", "longest_s"});
}

// The first half of the scans of a drive, and the last.
void AlignHalves(const NamedDrive& drive, const Effort& effort, Table& table) {
  const size_t scans = drive.scans.size();
  const auto a = MapOfPiece(drive, 0, scans / 2, {});
  const double shared = SharedPart(*a, *MapOfPiece(drive, scans / 2, scans, {}));
  const Eigen::Vector2d middle_m = MiddleOf(drive, scans / 2, scans);
  std::mt19937_64 random(1);
  const std::vector<Aligner> aligners = Aligners();
  std::vector<Tally> tallies(aligners.size());
  for (int n = 0; n < effort.transforms; ++n) {
    const Pose2 b_T_world = AnyPose(random);
    const auto b = MapOfPiece(drive, scans / 2, scans, b_T_world);
    for (size_t k = 0; k < aligners.size(); ++k) {
      Judge(TimedAlign(aligners[k], *a, *b, tallies[k]), b_T_world, middle_m, tallies[k]);
    }
  }
  for (size_t k = 0; k < aligners.size(); ++k) {
    WriteTally(drive.name, shared, aligners[k].name, tallies[k], table);
  }
}

// Two stretches of a tenth to a half of a drive, which share no scan, by how much of the map they
// share.
void AlignStretches(const NamedDrive& drive, const Effort& effort, Table& table) {
  constexpr std::array<double, 5> kLeastShared = {0, 0.1, 0.2, 1 / 3.0, 0.5};
  std::mt19937_64 random(3);
  std::uniform_real_distribution<double> share(0, 1);
  const std::vector<Aligner> aligners = Aligners();
  std::vector<std::vector<Tally>> tallies(kLeastShared.size(), std::vector<Tally>(aligners.size()));
  const auto scans = static_cast<double>(drive.scans.size());
  for (int n = 0; n < effort.stretches; ++n) {
    const double first_part = 0.1 + 0.4 * share(random);
    const double last_part = 0.1 + 0.4 * share(random);
    const double rest = 1 - first_part - last_part;
    const double start = rest * share(random);
    const double gap = (rest - start) * share(random);
    const auto at = [&](double part) { return static_cast<size_t>(part * scans); };
    const size_t a0 = at(start);
    const size_t a1 = at(start + first_part);
    const size_t b0 = at(start + first_part + gap);
    const size_t b1 = at(start + first_part + gap + last_part);
    const Pose2 b_T_world = AnyPose(random);
    const auto a = MapOfPiece(drive, a0, a1, {});
    const double shared = SharedPart(*a, *MapOfPiece(drive, b0, b1, {}));
    fmt::print(stderr, "pair {}, shared {:.2f}, scans {}-{} and {}-{}\n", n, shared, a0, a1, b0,
               b1);
    const auto bin = std::upper_bound(kLeastShared.begin(), kLeastShared.end(), shared) - 1;
    std::vector<Tally>& tallies_of_bin = tallies[bin - kLeastShared.begin()];
    const auto b = MapOfPiece(drive, b0, b1, b_T_world);
    for (size_t k = 0; k < aligners.size(); ++k) {
      Judge(TimedAlign(aligners[k], *a, *b, tallies_of_bin[k]), b_T_world, MiddleOf(drive, b0, b1),
            tallies_of_bin[k]);
    }
  }
  for (size_t bin = 0; bin < tallies.size(); ++bin) {
    for (size_t k = 0; k < aligners.size(); ++k) {
      const Tally& tally = tallies[bin][k];
      if (tally.right + tally.refused + tally.wrong == 0) continue;
      WriteTally(drive.name, kLeastShared[bin], aligners[k].name, tally, table);
    }
  }
}

// A piece of a fifth of a drive or more.
std::shared_ptr<const MapView> AnyPiece(const NamedDrive& drive, std::mt19937_64& random) {
  std::uniform_real_distribution<double> share(0, 1);
  const double part = 0.2 + 0.8 * share(random);
  const double first = (1 - part) * share(random);
  const auto scans = static_cast<double>(drive.scans.size());
  return MapOfPiece(drive, static_cast<size_t>(first * scans),
                    static_cast<size_t>((first + part) * scans), AnyPose(random));
}

// Pieces of different buildings have no place to each other. The peer gets one pair of five.
void AlignStrangers(const std::vector<NamedDrive>& drives, const Effort& effort,
                    const std::string& out) {
  constexpr int kPairsOfPeer = 5;
  std::mt19937_64 random(2);
  const std::vector<Aligner> aligners = Aligners();
  std::vector<Tally> tallies(aligners.size());
  for (int n = 0; n < effort.strangers; ++n) {
    const size_t first = random() % drives.size();
    const size_t second = (first + 1 + random() % (drives.size() - 1)) % drives.size();
    const auto a = AnyPiece(drives[first], random);
    const auto b = AnyPiece(drives[second], random);
    for (size_t k = 0; k < aligners.size(); ++k) {
      if (k > 0 && n % kPairsOfPeer != 0) continue;
      const auto found = TimedAlign(aligners[k], *a, *b, tallies[k]);
      ++(found ? tallies[k].wrong : tallies[k].refused);
      if (found) {
        fmt::print(stderr, "pair {}: {} aligned {} and {}\n", n, aligners[k].name,
                   drives[first].name, drives[second].name);
      }
    }
  }
  Table table(out + "/strangers.csv", {"aligner", "pairs", "refused", "aligned", "mean_s"});
  for (size_t k = 0; k < aligners.size(); ++k) {
    const int pairs = tallies[k].refused + tallies[k].wrong;
    table.Row(aligners[k].name, pairs, tallies[k].refused, tallies[k].wrong,
              tallies[k].time_s / pairs);
  }
}

}  // namespace
}  // namespace splinemap

int main(int argc, char** argv) {
  using namespace splinemap;
  CLI::App app("How well maps are aligned, beside a matcher of features, as CSV tables");
  std::string out = "align";
  std::string only;
  bool quick = false;
  Effort effort;
  app.add_option("--out", out, "Directory for the tables")->capture_default_str();
  std::string only_drive;
  app.add_option("--drive", only_drive, "One of the drives, for halves and stretches");
  app.add_option("--only", only, "One part alone")
      ->check(CLI::IsMember({"halves", "stretches", "strangers"}));
  app.add_option("--transforms", effort.transforms, "Of the halves of each drive")
      ->capture_default_str();
  app.add_option("--stretches", effort.stretches, "Pairs of stretches of each drive")
      ->capture_default_str();
  app.add_option("--strangers", effort.strangers, "Pairs of different buildings")
      ->capture_default_str();
  app.add_flag("--quick", quick, "A smoke run of a few seconds; its figures mean nothing");
  CLI11_PARSE(app, argc, argv);
  if (quick) effort = {1, 2, 2};
  std::filesystem::create_directories(out);
  std::vector<NamedDrive> drives = ReadBuildings();
  if (drives.size() < 2) {
    fmt::print(stderr, "the recorded drives are not there (../shared/data)\n");
    return 0;
  }
  if (quick) drives.resize(2);
  if (!only_drive.empty()) {
    std::erase_if(drives, [&](const NamedDrive& other) { return other.name != only_drive; });
  }
  const auto is_wanted = [&](const char* name) { return only.empty() || only == name; };
  if (is_wanted("halves")) {
    Table table = TableOfTallies(out + "/halves.csv");
    for (const NamedDrive& drive : drives) AlignHalves(drive, effort, table);
  }
  if (is_wanted("stretches")) {
    Table table = TableOfTallies(out + "/stretches.csv");
    for (const NamedDrive& drive : drives) AlignStretches(drive, effort, table);
  }
  if (is_wanted("strangers")) AlignStrangers(drives, effort, out);
}
