// Rays, sweeps and distances of the map of a simulated drive, beside grids of the same map.
#include <dynamicEDT3D/dynamicEDT3D.h>
#include <fmt/format.h>
#include <octomap/OcTree.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <array>
#include <chrono>
#include <cstdio>
#include <functional>
#include <numbers>
#include <opencv2/imgproc.hpp>
#include <random>

#include "lib/base/clock.h"
#include "lib/config/config.h"
#include "lib/distance/distance_field.h"
#include "lib/mapping/beam_model.h"
#include "lib/mapping/scan_scratch.h"
#include "splinemap/local_map.h"
#include "tests/bench/speed/workload.h"
#include "tests/support/map_writer.h"

namespace splinemap::bench {
namespace {

using Points = std::vector<Eigen::Vector2d>;

constexpr double kRayRange_m = 30;
constexpr double kRadius_m = 0.2;
constexpr double kDistance_m = 2;

double Median(std::vector<double> values) {
  std::nth_element(values.begin(), values.begin() + values.size() / 2, values.end());
  return values[values.size() / 2];
}

double SecondsOf(const std::function<void()>& work) {
  const auto begin = Clock::now();
  work();
  return std::chrono::duration<double>(Clock::now() - begin).count();
}

// Keeps what is computed from being left out.
volatile double sink;

class Mapper {
 public:
  void Insert(const RecordedScan& scan) {
    model_.Accumulate(Place(scan), scratch_);
    scratch_.CommitTo(layer_, map_.options().limits);
  }
  std::shared_ptr<const MapView> View() { return map_.View(); }

 private:
  const config::Method method_;
  MapWriter map_{MapOptionsOf(method_)};
  Layer& layer_ = map_.AddLayer({"bench", 1}, {1, 1});
  BeamModel model_{BeamModelOptionsOf(method_), kResolution_m};
  ScanScratch scratch_;
};

// The map at the centres of cells, of kResolution_m: < 0 free, > 0 occupied, 0 unknown.
struct Grid {
  Eigen::Vector2i first;  // cell of the map frame
  int width = 0;
  int height = 0;
  std::vector<int16_t> cells;

  Grid(const LocalMap& map, const Eigen::AlignedBox2d& bounds_m)
      : first((bounds_m.min() / kResolution_m).array().floor().cast<int>()) {
    const Eigen::Vector2d size = bounds_m.sizes() / kResolution_m;
    width = static_cast<int>(size.x()) + 1;
    height = static_cast<int>(size.y()) + 1;
    cells = map.Ask(RasterQuery{Centre(0, 0), kResolution_m, width, height})->cells;
  }
  Eigen::Vector2d Centre(int x, int y) const {
    return kResolution_m * ((first + Eigen::Vector2i(x, y)).cast<double>().array() + 0.5);
  }
  Eigen::Vector2i CellAt(const Eigen::Vector2d& point_m) const {
    return (point_m / kResolution_m).array().floor().cast<int>().matrix() - first;
  }
  bool IsIn(int x, int y) const { return x >= 0 && y >= 0 && x < width && y < height; }
  bool IsOccupied(int x, int y) const { return IsIn(x, y) && cells[y * width + x] > 0; }
};

// Amanatides and Woo.
double CastOverGrid(const Grid& grid, const Ray& ray) {
  const Eigen::Vector2d direction(std::cos(ray.bearing_rad), std::sin(ray.bearing_rad));
  Eigen::Vector2i cell = grid.CellAt(ray.origin_m);
  Eigen::Vector2d next;
  Eigen::Vector2d step_m = kResolution_m * direction.cwiseAbs().cwiseInverse();
  for (int k = 0; k < 2; ++k) {
    const int edge = cell[k] + grid.first[k] + (direction[k] > 0 ? 1 : 0);
    next[k] = (edge * kResolution_m - ray.origin_m[k]) / direction[k];
  }
  double range_m = 0;
  while (range_m < ray.max_range_m && grid.IsIn(cell.x(), cell.y())) {
    if (grid.cells[cell.y() * grid.width + cell.x()] > 0) return range_m;
    const int k = next.x() < next.y() ? 0 : 1;
    range_m = next[k];
    next[k] += step_m[k];
    cell[k] += direction[k] > 0 ? 1 : -1;
  }
  return ray.max_range_m;
}

// All cells whose centres are in the capsule.
bool IsClearInGrid(const Grid& grid, const Sweep& sweep) {
  const Eigen::Vector2d& from = sweep.path_m[0];
  const Eigen::Vector2d way = sweep.path_m[1] - from;
  const Eigen::Vector2d margin = Eigen::Vector2d::Constant(sweep.radius_m);
  const Eigen::Vector2i low = grid.CellAt(from.cwiseMin(sweep.path_m[1]) - margin);
  const Eigen::Vector2i high = grid.CellAt(from.cwiseMax(sweep.path_m[1]) + margin);
  for (int y = low.y(); y <= high.y(); ++y) {
    for (int x = low.x(); x <= high.x(); ++x) {
      if (!grid.IsOccupied(x, y)) continue;
      const Eigen::Vector2d offset = grid.Centre(x, y) - from;
      const double along = std::clamp(offset.dot(way) / way.squaredNorm(), 0.0, 1.0);
      if ((offset - along * way).norm() <= sweep.radius_m) return false;
    }
  }
  return true;
}

octomap::point3d ToPoint3d(const Eigen::Vector2d& point) {
  return {static_cast<float>(point.x()), static_cast<float>(point.y()),
          static_cast<float>(kResolution_m / 2)};
}

void Fill(const Grid& grid, octomap::OcTree& tree) {
  for (int y = 0; y < grid.height; ++y) {
    for (int x = 0; x < grid.width; ++x) {
      const int16_t cell = grid.cells[y * grid.width + x];
      if (cell != 0) tree.updateNode(ToPoint3d(grid.Centre(x, y)), cell > 0, /*lazy_eval=*/true);
    }
  }
  tree.updateInnerOccupancy();
}

// What cv::distanceTransform() takes.
cv::Mat ObstacleImage(const Grid& grid) {
  cv::Mat obstacles(grid.height, grid.width, CV_8U);
  for (size_t n = 0; n < grid.cells.size(); ++n) obstacles.data[n] = grid.cells[n] > 0 ? 0 : 1;
  return obstacles;
}

struct Contestant {
  std::string name;
  std::function<void()> work;  // on all items
};

// The first is splinemap. Ratio: its speed to theirs.
void Compete(const std::string& what, size_t items, int repetitions,
             const std::vector<Contestant>& all) {
  std::vector<std::vector<double>> times_s(all.size());
  for (int n = 0; n < repetitions; ++n) {
    for (size_t k = 0; k < all.size(); ++k) times_s[k].push_back(SecondsOf(all[k].work));
  }
  const auto count = static_cast<double>(items);
  const double own = count / Median(times_s[0]);
  for (size_t k = 1; k < all.size(); ++k) {
    const double peer = count / Median(times_s[k]);
    fmt::print("{:<34} | {:>10.3g} | {:<34} {:>10.3g} | {:>8.3f}\n", what, own, all[k].name, peer,
               own / peer);
  }
  std::fflush(stdout);
}

// How far the field, and the grid, are from what the map says; in knot intervals.
void PrintErrors(
    const DistancesQuery& query, const std::vector<DistancesQuery::Distance>& exact,
    const std::function<std::array<double, 2>(const Eigen::Vector2d& point_m)>& look_up_m) {
  std::array<std::vector<double>, 2> errors;
  for (size_t n = 0; n < exact.size(); ++n) {
    const std::array<double, 2> distances_m = look_up_m(query.points_m[n]);
    for (int k = 0; k < 2; ++k) {
      errors[k].push_back(std::abs(distances_m[k] - exact[n].distance_m) / kResolution_m);
    }
  }
  for (int k = 0; k < 2; ++k) {
    std::sort(errors[k].begin(), errors[k].end());
    fmt::print(
        "{}: differs from the search by {:.3f} knot intervals in the median, {:.3f} at 99 %, "
        "{:.3f} at most\n",
        k == 0 ? "DistanceField" : "OpenCV distanceTransform", errors[k][exact.size() / 2],
        errors[k][exact.size() * 99 / 100], errors[k].back());
  }
}

void Run(const Workload& workload, int repetitions, size_t items) {
  const size_t updates = std::min(workload.scans.size() / 10, items / 20);
  const size_t mapped = workload.scans.size() - updates;
  const auto bounds_m = BoundsOf(workload);
  Mapper mapper;
  for (size_t n = 0; n < mapped; ++n) mapper.Insert(workload.scans[n]);
  LocalMap map(mapper.View());
  Grid grid(map, bounds_m);
  octomap::OcTree tree(kResolution_m);
  Fill(grid, tree);
  DynamicEDT3D dynamic(static_cast<int>(std::pow(kDistance_m / kResolution_m, 2)));
  dynamic.initializeEmpty(grid.width, grid.height, 1);
  for (int y = 0; y < grid.height; ++y) {
    for (int x = 0; x < grid.width; ++x) {
      if (grid.IsOccupied(x, y)) dynamic.occupyCell(x, y, 0);
    }
  }
  dynamic.update();
  cv::Mat image;
  cv::distanceTransform(ObstacleImage(grid), image, cv::DIST_L2, cv::DIST_MASK_PRECISE);

  std::mt19937_64 random(1);
  const auto uniform = [&](double end) {
    return std::uniform_real_distribution<double>(0, end)(random);
  };
  RaysQuery rays;
  rays.unknown = UnknownPolicy::kFree;
  const size_t stride = std::max<size_t>(1, mapped * 360 / items);
  for (size_t n = 0; n < mapped; n += stride) {
    for (int beam = 0; beam < 360; ++beam) {
      const Pose2& pose = workload.scans[n].world_T_sensor;
      rays.rays.push_back(
          {pose.position_m, pose.yaw_rad + beam * std::numbers::pi / 180, kRayRange_m});
    }
  }
  SweepsQuery sweeps;
  sweeps.unknown = UnknownPolicy::kFree;
  DistancesQuery distances;
  distances.max_distance_m = kDistance_m;
  while (distances.points_m.size() < items) {
    distances.points_m.emplace_back(
        bounds_m.min() +
        Eigen::Vector2d(uniform(bounds_m.sizes().x()), uniform(bounds_m.sizes().y())));
    const Eigen::Vector2i cell = grid.CellAt(distances.points_m.back());
    if (grid.cells[cell.y() * grid.width + cell.x()] >= 0) continue;
    const double bearing_rad = uniform(2 * std::numbers::pi);
    const Eigen::Vector2d& from = distances.points_m.back();
    const Eigen::Vector2d way(std::cos(bearing_rad), std::sin(bearing_rad));
    sweeps.sweeps.push_back({{from, from + way}, kRadius_m});
  }

  fmt::print("{}, {} x {} cells\n{:<34} | {:>10} | {:<45} | {:>8}\n", workload.name, grid.width,
             grid.height, "a second", "splinemap", "peer", "ratio");
  const auto cast_octomap = [&] {
    octomap::point3d end;
    for (const Ray& ray : rays.rays) {
      const Eigen::Vector2d direction(std::cos(ray.bearing_rad), std::sin(ray.bearing_rad));
      sink = tree.castRay(ToPoint3d(ray.origin_m),
                          {static_cast<float>(direction.x()), static_cast<float>(direction.y()), 0},
                          end, true, kRayRange_m);
    }
  };
  Compete("rays, 360 a pose, 30 m", rays.rays.size(), repetitions,
          {{"", [&] { sink = map.Ask(rays)->ends[0].range_m; }},
           {"OctoMap castRay", cast_octomap},
           {"grid, Amanatides and Woo", [&] {
              for (const Ray& ray : rays.rays) sink = CastOverGrid(grid, ray);
            }}});
  Compete("sweeps, 1 m, radius 0.2 m", sweeps.sweeps.size(), repetitions,
          {{"", [&] { sink = map.Ask(sweeps)->results[0].free_m; }},
           {"grid, cells of the capsule", [&] {
              for (const Sweep& sweep : sweeps.sweeps) sink = IsClearInGrid(grid, sweep);
            }}});
  const auto results = map.Ask(sweeps)->results;
  size_t clear = 0;
  size_t same = 0;
  for (size_t n = 0; n < results.size(); ++n) {
    const bool is_clear = IsClearInGrid(grid, sweeps.sweeps[n]);
    clear += is_clear ? 1 : 0;
    same += is_clear == (results[n].occupancy == Occupancy::kFree) ? 1 : 0;
  }
  fmt::print("of {} sweeps {} are clear in the grid; {} are alike\n", results.size(), clear, same);
  const auto look_up_dynamic = [&] {
    for (const Eigen::Vector2d& point_m : distances.points_m) {
      const Eigen::Vector2i cell = grid.CellAt(point_m);
      sink = dynamic.getDistance(cell.x(), cell.y(), 0);
    }
  };
  const auto look_up_image = [&] {
    for (const Eigen::Vector2d& point_m : distances.points_m) {
      const Eigen::Vector2i cell = grid.CellAt(point_m);
      sink = image.at<float>(cell.y(), cell.x());
    }
  };
  Compete("distances, 2 m at most", items, repetitions,
          {{"", [&] { sink = map.Ask(distances)->distances[0].distance_m; }},
           {"dynamicEDT3D, lookup", look_up_dynamic},
           {"OpenCV distanceTransform, lookup", look_up_image}});
  DistanceFieldEditor editor({.max_distance_m = kDistance_m});
  DistanceField field = editor.Update(map.View());
  const auto look_up_field = [&] {
    for (const Eigen::Vector2d& point_m : distances.points_m) sink = field.At(point_m).distance_m;
  };
  Compete("DistanceField, 2 m at most", items, repetitions,
          {{"", look_up_field},
           {"dynamicEDT3D, lookup", look_up_dynamic},
           {"OpenCV distanceTransform, lookup", look_up_image}});
  PrintErrors(distances, map.Ask(distances)->distances, [&](const Eigen::Vector2d& point_m) {
    const Eigen::Vector2i cell = grid.CellAt(point_m);
    return std::array{field.At(point_m).distance_m,
                      std::min(kDistance_m, kResolution_m * image.at<float>(cell.y(), cell.x()))};
  });
  fmt::print("the field takes {:.2f} bytes a control point of the map\n",
             static_cast<double>(field.tiles().size() * sizeof(DistanceTile)) /
                 static_cast<double>(map.View()->tiles.size() * Tile::kSize));

  // Scan after scan; what is said of the grid is that it is there already.
  const DistancesQuery one{{workload.scans[0].world_T_sensor.position_m}, kDistance_m};
  std::vector<double> own_s;
  std::vector<double> field_s;
  std::vector<double> dynamic_s;
  std::vector<double> image_s;
  for (size_t n = mapped; n < workload.scans.size(); ++n) {
    mapper.Insert(workload.scans[n]);
    const auto view = mapper.View();
    own_s.push_back(SecondsOf([&] {
      map.Use(view);
      sink = map.Ask(one)->distances[0].distance_m;
    }));
    field_s.push_back(SecondsOf([&] { field = editor.Update(view); }));
    const Grid next(map, bounds_m);
    for (size_t k = 0; k < next.cells.size(); ++k) {
      const int x = static_cast<int>(k) % next.width;
      const int y = static_cast<int>(k) / next.width;
      if (next.IsOccupied(x, y) == grid.IsOccupied(x, y)) continue;
      next.IsOccupied(x, y) ? dynamic.occupyCell(x, y, 0) : dynamic.clearCell(x, y, 0);
    }
    dynamic_s.push_back(SecondsOf([&] { dynamic.update(); }));
    const cv::Mat obstacles = ObstacleImage(next);
    image_s.push_back(SecondsOf(
        [&] { cv::distanceTransform(obstacles, image, cv::DIST_L2, cv::DIST_MASK_PRECISE); }));
    grid = next;
  }
  const auto print = [&](const char* what, const std::vector<double>& times_s, const char* name,
                         const std::vector<double>& peer_times_s) {
    const double own = 1 / Median(times_s);
    const double peer = 1 / Median(peer_times_s);
    fmt::print("{:<34} | {:>10.3g} | {:<34} {:>10.3g} | {:>8.3f}\n", what, own, name, peer,
               own / peer);
  };
  print("a scan's change, then a distance", own_s, "dynamicEDT3D, update", dynamic_s);
  print("a scan's change, then a distance", own_s, "OpenCV distanceTransform, anew", image_s);
  print("a scan's change to DistanceField", field_s, "dynamicEDT3D, update", dynamic_s);
  print("a scan's change to DistanceField", field_s, "OpenCV distanceTransform, anew", image_s);
}

int Main(int argc, char** argv) {
  CLI::App app("asking_bench: rays, sweeps and distances beside grids of the same map");
  bool quick = false;
  app.add_flag("--quick", quick, "A little of everything; the figures say nothing");
  CLI11_PARSE(app, argc, argv);
  cv::setNumThreads(1);
  const auto workload = MakeWorkload("simulated_1440_beams_25_m", quick ? 100 : 1000);
  if (!workload) return 1;
  Run(*workload, quick ? 1 : 5, quick ? 1000 : 20'000);
  return 0;
}

}  // namespace
}  // namespace splinemap::bench

int main(int argc, char** argv) { return splinemap::bench::Main(argc, argv); }
