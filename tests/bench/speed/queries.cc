// Value and gradient at points of a map that is far larger than the caches.
#include <benchmark/benchmark.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <memory>
#include <numbers>
#include <random>
#include <vector>

#include "absl/container/flat_hash_map.h"
#include "absl/types/span.h"
#include "splinemap/map_view.h"
#include "tests/bench/speed/benchmarks.h"
#include "tests/bench/speed/tile_square.h"
#include "tests/support/map_writer.h"

namespace splinemap::bench {
namespace {

constexpr size_t kNumPoints = size_t{1} << 20;
constexpr size_t kBatch = 1024;

using Points = std::vector<Eigen::Vector2d>;

class QueryMap {
 public:
  explicit QueryMap(size_t num_tiles) : square_(num_tiles), map_({kResolution_m, {}}) {
    square_.CommitTo(map_.AddLayer({"bench", 1}, {1, 1}));
    view_ = map_.View();
    view_->tiles.ForEach([&](TileKey key, const TileTree::Entry& entry) {
      numbers_[key] = static_cast<uint32_t>(tiles_.size());
      held_.push_back(entry.tile->Get());
      tiles_.push_back(held_.back().get());
    });
  }

  const MapView& view() const { return *view_; }
  std::shared_ptr<const MapView> shared_view() const { return view_; }
  double half_width_m() const { return (square_.half() - 1) * Tile::kSide * kResolution_m; }

  const std::vector<const Tile*>& tiles() const { return tiles_; }
  uint32_t NumberOf(TileKey key) const { return numbers_.at(key); }

 private:
  TileSquare square_;
  MapWriter map_;
  std::shared_ptr<const MapView> view_;
  std::vector<std::shared_ptr<const Tile>> held_;
  std::vector<const Tile*> tiles_;  // the same
  absl::flat_hash_map<TileKey, uint32_t> numbers_;
};

Points RandomPoints(double half_width_m) {
  std::mt19937_64 random(1);
  std::uniform_real_distribution<double> coordinate_m(-half_width_m, half_width_m);
  Points points;
  while (points.size() < kNumPoints) {
    const double x_m = coordinate_m(random);
    points.emplace_back(x_m, coordinate_m(random));
  }
  return points;
}

// A winding path through the map, a point every centimetre.
Points PathPoints(double half_width_m) {
  std::mt19937_64 random(1);
  std::normal_distribution<double> turn_rad(0, 0.02);
  Points points;
  Eigen::Vector2d point_m(0, 0);
  double yaw_rad = 0;
  while (points.size() < kNumPoints) {
    points.push_back(point_m);
    yaw_rad += turn_rad(random);
    if (point_m.lpNorm<Eigen::Infinity>() > half_width_m - 1) {
      yaw_rad = std::atan2(-point_m.y(), -point_m.x());
    }
    point_m += 0.01 * Eigen::Vector2d(std::cos(yaw_rad), std::sin(yaw_rad));
  }
  return points;
}

// Four control points beside each other in a tile.
struct Four {
  uint32_t tile = 0;  // in QueryMap::tiles()
  uint32_t index = 0;
};
// What a batch of points needs: four rows for each, and as many more where they go on in the next
// tile.
using Fours = std::vector<Four>;

std::vector<Fours> FoursOf(const Points& points, const QueryMap& map) {
  std::vector<Fours> batches(points.size() / kBatch);
  for (size_t n = 0; n < batches.size() * kBatch; ++n) {
    const int32_t i = LocateKnot(points[n].x(), kResolution_m)->index - 1;
    const int32_t j = LocateKnot(points[n].y(), kResolution_m)->index - 1;
    for (int row = 0; row < 4; ++row) {
      const TileKey key = TileOf(i, j + row);
      const TileKey last = TileOf(i + 3, j + row);
      const auto add = [&](TileKey of, int column) {
        batches[n / kBatch].push_back(
            {map.NumberOf(of), static_cast<uint32_t>(IndexInTile(column, j + row))});
      };
      add(key, std::min(i & (Tile::kSide - 1), Tile::kSide - 4));
      if (last != key) add(last, 0);
    }
  }
  return batches;
}

// Times `query` of one batch of `all` after the other.
template <typename T, typename Query>
void TimeBatches(benchmark::State& state, const std::vector<T>& all, Query query) {
  size_t begin = 0;
  for (auto _ : state) {
    query(absl::MakeConstSpan(all).subspan(begin, kBatch));
    begin = (begin + kBatch) % all.size();
  }
  state.SetItemsProcessed(state.iterations() * static_cast<int64_t>(kBatch));
}

void EvaluateOneByOne(const MapView& view, absl::Span<const Eigen::Vector2d> points) {
  for (const Eigen::Vector2d& point : points) {
    SurfaceSample sample = view.Evaluate(point.x(), point.y());
    benchmark::DoNotOptimize(sample);
  }
}

void EvaluateByReader(PathReader& reader, absl::Span<const Eigen::Vector2d> points) {
  for (const Eigen::Vector2d& point : points) {
    SurfaceSample sample = reader.Evaluate(point.x(), point.y());
    benchmark::DoNotOptimize(sample);
  }
}

void EvaluateBatch(const MapView& view, absl::Span<const Eigen::Vector2d> points) {
  static std::vector<SurfaceSample> samples(kBatch);
  view.EvaluateMany(points, absl::MakeSpan(samples));
  benchmark::DoNotOptimize(samples.data());
  benchmark::ClobberMemory();
}

// The limit: tiles through a flat array of pointers, and nothing computed.
void Load(const std::vector<const Tile*>& tiles, const Fours& batch) {
  uint64_t sum = 0;
  for (const Four& place : batch) {
    uint64_t four;
    std::memcpy(&four, &tiles[place.tile]->control_points[place.index], sizeof(four));
    sum += four;
  }
  benchmark::DoNotOptimize(sum);
}

void TimeLoads(benchmark::State& state, const QueryMap& map, const std::vector<Fours>& batches) {
  size_t n = 0;
  for (auto _ : state) {
    Load(map.tiles(), batches[n]);
    n = (n + 1) % batches.size();
  }
  state.SetItemsProcessed(state.iterations() * static_cast<int64_t>(kBatch));
}

}  // namespace

void RegisterQueries(size_t num_tiles) {
  const auto map = std::make_shared<const QueryMap>(num_tiles);
  const auto random = std::make_shared<const Points>(RandomPoints(map->half_width_m()));
  const auto path = std::make_shared<const Points>(PathPoints(map->half_width_m()));
  const auto fours = std::make_shared<const std::vector<Fours>>(FoursOf(*random, *map));

  const auto add = [](const std::string& name, auto all, auto query) {
    benchmark::RegisterBenchmark(
        name.c_str(), [all, query](benchmark::State& state) { TimeBatches(state, *all, query); });
  };
  const auto one_by_one = [map](absl::Span<const Eigen::Vector2d> points) {
    EvaluateOneByOne(map->view(), points);
  };
  const auto batch_of = [map](absl::Span<const Eigen::Vector2d> points) {
    EvaluateBatch(map->view(), points);
  };
  add("queries/random/single", random, one_by_one);
  add("queries/random/batched", random, batch_of);
  add("queries/path/single", path, one_by_one);
  add("queries/path/batched", path, batch_of);
  const auto reader = std::make_shared<PathReader>(map->shared_view());
  add("queries/path/reader", path,
      [reader](absl::Span<const Eigen::Vector2d> points) { EvaluateByReader(*reader, points); });
  benchmark::RegisterBenchmark("queries/random/limit", [map, fours](benchmark::State& state) {
    TimeLoads(state, *map, *fours);
  });
}

}  // namespace splinemap::bench
