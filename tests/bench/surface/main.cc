// Where maps of simulated drives have the faces of things whose place is known. Writes surface.csv,
// and level.csv for a picture; report.py makes the tables, plot.py draws.
#include <CLI/CLI.hpp>
#include <cmath>
#include <filesystem>
#include <numeric>

#include "tests/bench/accuracy/mrpt_map.h"
#include "tests/bench/accuracy/spline_map.h"
#include "tests/bench/accuracy/table.h"
#include "tests/bench/surface/measure.h"
#include "tests/bench/surface/scene.h"
#include "tests/bench/surface/tsdf_map.h"

namespace splinemap {
namespace {

constexpr double kKnotInterval_m = 0.05;

std::vector<Method> Methods() {
  std::vector<Method> methods;
  for (const Variant& variant : Variants()) {
    if (variant.name == "signed distance") {
      methods.push_back(SplineMethod(variant));
      methods.back().name = "splinemap";
    } else if (variant.name == "samples") {
      methods.push_back(SplineMethod(variant));
      methods.back().name = "paper's spline";
    }
  }
  methods.push_back(MrptMethod("MRPT's grid", kMrptDefaultCertainty));
  methods.push_back(TsdfMethod("signed distance field", 3));
  return methods;
}

struct Condition {
  Sensing sensing;
  double knot_interval_m = kKnotInterval_m;
};

// The bench's usual one, and those that differ from it in one way.
std::vector<Condition> Conditions() {
  std::vector<Condition> conditions(1);
  const auto add = [&](auto change) {
    conditions.emplace_back();
    change(conditions.back());
  };
  for (const double noise_m : {0.0, 0.03}) {
    add([=](Condition& c) { c.sensing.noise_sigma_m = noise_m; });
  }
  add([](Condition& c) { c.sensing.mixed_share = 0.3; });
  for (const int beams : {90, 720, 1440}) add([=](Condition& c) { c.sensing.beams = beams; });
  for (const int scans : {10, 1000}) add([=](Condition& c) { c.sensing.scans = scans; });
  for (const double knot_m : {0.025, 0.1}) add([=](Condition& c) { c.knot_interval_m = knot_m; });
  return conditions;
}

std::vector<Scene> Scenes() {
  std::vector<Scene> scenes;
  for (const double incidence_deg : {0, 30, 45, 60, 70, 80}) {
    scenes.push_back(WallScene(1.5, incidence_deg));
  }
  scenes.push_back(WallScene(0.5, 0));
  scenes.push_back(WallScene(8, 0));
  scenes.push_back(WallScene(5, 60));
  for (const bool convex : {true, false}) scenes.push_back(CornerScene(convex));
  for (const double width_m : {0.6, 0.7, 0.8, 0.9}) scenes.push_back(DoorScene(width_m, 0.12));
  scenes.push_back(DoorScene(0.8, 0.01));
  for (const double width_m : {0.1, 0.2}) scenes.push_back(DoorScene(width_m, 0.12));
  for (const double thickness_m : {0.01, 0.05, 0.12}) {
    for (const bool both : {false, true}) scenes.push_back(ThinWallScene(thickness_m, both));
  }
  for (const double diameter_m : {0.01, 0.02, 0.03, 0.05, 0.1, 0.3}) {
    for (const bool all : {false, true}) scenes.push_back(PoleScene(diameter_m, all));
  }
  return scenes;
}

// Those that are seen under all conditions.
std::vector<Scene> SomeScenes() {
  return {WallScene(1.5, 0),    WallScene(1.5, 60),        CornerScene(true),
          DoorScene(0.8, 0.12), ThinWallScene(0.12, true), PoleScene(0.05, true)};
}

// Ten places between the knots; half of them along the axes of the map.
Pose2 Place(int n, double knot_interval_m) {
  const double part = 0.1 * n * knot_interval_m;
  return {{part + 0.003, 0.7 * part + 0.021}, n % 2 == 0 ? 0.0 : 0.31 * n};
}

double Mean(const std::vector<double>& values) {
  return std::accumulate(values.begin(), values.end(), 0.0) / static_cast<double>(values.size());
}

double StandardDeviation(const std::vector<double>& values) {
  const double mean = Mean(values);
  double sum = 0;
  for (const double value : values) sum += (value - mean) * (value - mean);
  return std::sqrt(sum / static_cast<double>(values.size()));
}

class Bench {
 public:
  Bench(const std::string& out, int places)
      : table_(out + "/surface.csv",
               {"scene", "method", "knot_interval_m", "noise_m", "mixed_share", "beams", "scans",
                "ray_bias_mm", "ray_sd_mm", "found", "distance_bias_mm", "distance_sd_mm",
                "gap_bias_mm", "gap_sd_mm"}),
        places_(places) {}

  void Run(const Scene& scene, const Method& method, const Condition& condition) {
    std::vector<double> rays_mm;
    std::vector<double> distances_mm;
    std::vector<double> gaps_mm;
    int found = 0;
    for (int n = 0; n < places_; ++n) {
      const Pose2 world_T_scene = Place(n, condition.knot_interval_m);
      const std::unique_ptr<TestedMap> map = method.make(condition.knot_interval_m);
      for (const auto& beams : Scans(scene, world_T_scene, condition.sensing, n + 1)) {
        map->AddScan(beams);
      }
      const Findings findings = Measure(*map, method.level, scene, world_T_scene);
      for (const double error_m : findings.ray_errors_m) rays_mm.push_back(1000 * error_m);
      for (const double error_m : findings.distance_errors_m) {
        distances_mm.push_back(1000 * error_m);
      }
      if (findings.gap_m) gaps_mm.push_back(1000 * (*findings.gap_m - scene.gap_width_m));
      found += 2 * findings.rays_missed <= findings.rays ? 1 : 0;
    }
    const Sensing& sensing = condition.sensing;
    table_.Row(scene.name, method.name, condition.knot_interval_m, sensing.noise_sigma_m,
               sensing.mixed_share, sensing.beams, sensing.scans, Mean(rays_mm),
               StandardDeviation(rays_mm), static_cast<double>(found) / places_, Mean(distances_mm),
               StandardDeviation(distances_mm), Mean(gaps_mm), StandardDeviation(gaps_mm));
  }

 private:
  Table table_;
  int places_;
};

// The surface across a wall, and where the level is along it, for the picture.
void WriteLevels(const std::vector<Method>& methods, const std::string& out) {
  Table table(out + "/level.csv", {"method", "scene", "x_m", "y_m", "is_obstacle"});
  for (const Method& method : methods) {
    for (const Scene& scene : {DoorScene(0.8, 0.12), PoleScene(0.05, true)}) {
      const Pose2 world_T_scene{{0.011, 0.017}, 0.2};
      const std::unique_ptr<TestedMap> map = method.make(kKnotInterval_m);
      for (const auto& beams : Scans(scene, world_T_scene, {}, 1)) map->AddScan(beams);
      const bool is_door = scene.gap_width_m > 0;
      const Eigen::Vector2d middle(0, is_door ? 0.06 : 0);
      const Eigen::Vector2d half =
          is_door ? Eigen::Vector2d(0.6, 0.2) : Eigen::Vector2d(0.15, 0.15);
      constexpr double kPixel_m = 0.004;
      for (double y = -half.y(); y <= half.y(); y += kPixel_m) {
        for (double x = -half.x(); x <= half.x(); x += kPixel_m) {
          const Eigen::Vector2d at = middle + Eigen::Vector2d(x, y);
          table.Row(method.name, std::string(is_door ? "door" : "pole"), at.x(), at.y(),
                    map->LogOdds(world_T_scene * at) > method.level ? 1 : 0);
        }
      }
    }
  }
}

void Run(bool quick, const std::string& out) {
  const std::vector<Method> methods = Methods();
  Bench bench(out, quick ? 1 : 10);
  const std::vector<Condition> conditions = Conditions();
  for (const Method& method : methods) {
    for (const Scene& scene : quick ? SomeScenes() : Scenes()) {
      bench.Run(scene, method, conditions.front());
    }
    for (size_t k = 1; k < (quick ? 3 : conditions.size()); ++k) {
      for (const Scene& scene : SomeScenes()) bench.Run(scene, method, conditions[k]);
    }
  }
  WriteLevels(methods, out);
}

}  // namespace
}  // namespace splinemap

int main(int argc, char** argv) {
  CLI::App app("Where maps have the faces of simulated things, as CSV tables");
  std::string out = "surface";
  bool quick = false;
  app.add_option("--out", out, "Directory for the tables")->capture_default_str();
  app.add_flag("--quick", quick, "A smoke run of a few seconds; its figures mean nothing");
  CLI11_PARSE(app, argc, argv);
  std::filesystem::create_directories(out);
  splinemap::Run(quick, out);
}
