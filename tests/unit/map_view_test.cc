#include "splinemap/map_view.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <atomic>
#include <bit>
#include <cmath>
#include <limits>
#include <map>
#include <memory>
#include <random>
#include <thread>
#include <vector>

#include "lib/base/mutex.h"
#include "lib/tiles/sum_kernel.h"
#include "lib/tiles/sum_tiles.h"
#include "lib/tiles/tile_memory.h"
#include "tests/support/map_writer.h"
#include "tests/support/random_map.h"

namespace splinemap::map_view_test {

constexpr ControlLimits kLimits;

TEST(ControlPointTest, TouchedIsNeverZeroAndStaysWithinLimits) {
  EXPECT_EQ(ClampTouched(0, kLimits), 1);
  EXPECT_EQ(ClampTouched(-1, kLimits), -1);
  EXPECT_EQ(ClampTouched(1 << 30, kLimits), kLimits.max);
  EXPECT_EQ(ClampTouched(-(1 << 30), kLimits), kLimits.min);
}

TEST(KnotTest, LocatesOnBothSidesOfTheOrigin) {
  EXPECT_EQ(LocateKnot(0.0, 0.05)->index, 0);
  EXPECT_EQ(LocateKnot(-0.01, 0.05)->index, -1);
  EXPECT_NEAR(LocateKnot(-0.01, 0.05)->t, 0.8, 1e-12);
  EXPECT_EQ(TileOf(-1, -33), (TileKey{-1, -2}));
  EXPECT_EQ(IndexInTile(-1, -32), 31);
}

TEST(KnotTest, RefusesWhatIsNoCoordinate) {
  const double infinity = std::numeric_limits<double>::infinity();
  for (const double bad : {infinity, -infinity, std::nan(""), 1e300, -1.4e7, 1.4e7}) {
    EXPECT_FALSE(LocateKnot(bad, 0.05)) << bad;
  }
}

TEST(SumTilesTest, DoesNotDependOnOrderOrGrouping) {
  std::mt19937_64 random(1);
  std::vector<Tile> tiles;
  for (int k = 0; k < 6; ++k) tiles.push_back(RandomTile(random));
  std::vector<const Tile*> pointers = {nullptr};
  for (const Tile& tile : tiles) pointers.push_back(&tile);
  const Tile merged = SumTiles(pointers, kLimits);
  for (int n = 0; n < 50; ++n) {
    std::shuffle(pointers.begin(), pointers.end(), random);
    EXPECT_EQ(SumTiles(pointers, kLimits), merged);
  }
}

TEST(SumTilesTest, ClampsOnceAtTheEnd) {
  // Saturating adds in between would give max + min = 0.
  std::array<Tile, 3> tiles;
  tiles[0].control_points[0] = kLimits.max;
  tiles[1].control_points[0] = kLimits.max;
  tiles[2].control_points[0] = kLimits.min;
  EXPECT_EQ(SumTiles({&tiles[0], &tiles[1], &tiles[2]}, kLimits).control_points[0], kLimits.max);
}

TEST(SumTilesTest, WhatCancelsStaysKnown) {
  std::array<Tile, 2> tiles;
  tiles[0].control_points[0] = 5;
  tiles[1].control_points[0] = -5;
  const Tile merged = SumTiles({&tiles[0], &tiles[1]}, kLimits);
  EXPECT_EQ(merged.control_points[0], 1);
  EXPECT_EQ(merged.control_points[1], 0);
}

// The definition.
Tile SimplySummed(const std::vector<const Tile*>& tiles, ControlLimits limits) {
  Tile merged;
  for (int k = 0; k < Tile::kSize; ++k) {
    int32_t sum = 0;
    bool touched = false;
    for (const Tile* tile : tiles) {
      if (tile == nullptr) continue;
      sum += tile->control_points[k];
      touched |= tile->control_points[k] != 0;
    }
    if (touched) merged.control_points[k] = ClampTouched(sum, limits);
  }
  return merged;
}

TEST(SumTilesTest, EveryKernelGivesTheSameBytes) {
  std::mt19937_64 random(4);
  for (const ControlLimits limits : {kLimits, ControlLimits{-3000, 700}}) {
    for (int count = 0; count <= 18; ++count) {
      std::vector<Tile> tiles;
      std::vector<const Tile*> pointers;
      for (int k = 0; k < count; ++k) tiles.push_back(RandomTile(random));
      for (const Tile& tile : tiles) pointers.push_back(random() % 5 == 0 ? nullptr : &tile);
      if (count > 1) {  // some that cancel
        for (int k = 0; k < 40; ++k) tiles[0].control_points[k] = -tiles[1].control_points[k];
      }
      const Tile expected = SimplySummed(pointers, limits);
      std::vector<const ControlPoint*> control_points;
      for (const Tile* tile : pointers) {
        control_points.push_back(tile == nullptr ? nullptr : tile->control_points.data());
      }
      for (const SumKernel& kernel : SumKernels()) {
        Tile sum;
        kernel.sum(control_points.data(), control_points.size(), limits, sum.control_points.data());
        EXPECT_EQ(sum, expected) << kernel.name << ", " << count << " tiles";
      }
    }
  }
}

// The view, kept up incrementally, equals the sum of the layers at every commit.
TEST(MapViewTest, FollowsRandomCommits) {
  std::mt19937_64 random(2);
  MapWriter map({0.05, kLimits});
  std::vector<Layer*> layers;
  for (uint64_t k = 1; k <= 3; ++k) layers.push_back(&map.AddLayer({"robot", k}, {1, 1}));
  for (int n = 0; n < 60; ++n) {
    for (Layer* layer : layers) {
      if (random() % 3 == 0) continue;
      layer->BeginCommit();
      for (int edit = 0; edit < 3; ++edit) {
        Tile& tile = layer->EditTile(RandomKey(random, 6));
        tile.control_points[random() % Tile::kSize] =
            static_cast<ControlPoint>(random() % 20000 - 10000);
      }
    }
    const LayerSet set = map.Layers();
    const auto view = map.View();
    std::map<std::pair<int, int>, std::vector<const Tile*>> by_key;
    std::vector<std::shared_ptr<const Tile>> held;
    uint64_t revision = 0;
    for (const LayerSnapshot& layer : set.layers) {
      revision += layer.revision;
      layer.tiles.ForEach([&](TileKey key, const TileTree::Entry& entry) {
        held.push_back(entry.tile->Get());
        by_key[{key.tx, key.ty}].push_back(held.back().get());
      });
    }
    ASSERT_EQ(view->revision, revision);
    ASSERT_EQ(view->tiles.size(), by_key.size());
    for (const auto& [key, tiles] : by_key) {
      const auto merged = FindTile(view->tiles, {key.first, key.second});
      ASSERT_NE(merged, nullptr);
      ASSERT_EQ(*merged, SumTiles(tiles, kLimits));
    }
  }
}

TEST(MapViewTest, ALayerThatGoesOnKeepsItsTilesAndRevision) {
  MapWriter map({0.05, kLimits});
  Layer& layer = map.AddLayer({"robot", 1}, {1, 1});
  layer.BeginCommit();
  layer.EditTile({0, 0}).control_points[0] = 4;
  const LayerSet set = map.Layers();
  const auto view = map.View();
  MapWriter next({0.05, kLimits});
  Layer& continued = next.ContinueLayer(set.layers[0], {2, 9});
  EXPECT_EQ(continued.id(), layer.id());
  EXPECT_EQ(continued.session().number, 2u);
  EXPECT_EQ(continued.revision(), 1u);
  continued.BeginCommit();
  continued.EditTile({0, 0}).control_points[0] = 5;
  EXPECT_EQ(next.Layers().layers[0].tiles.RevisionOf({0, 0}), 2u);
  EXPECT_EQ(FindTile(set.layers[0].tiles, {0, 0})->control_points[0], 4);
  EXPECT_EQ(FindTile(view->tiles, {0, 0})->control_points[0], 4);
}

TEST(LayerTest, UpdatesOfATileMayComeTwiceLateAndOutOfOrder) {
  std::vector<std::shared_ptr<const StoredTile>> versions;
  for (ControlPoint value = 1; value <= 5; ++value) {
    Tile tile;
    tile.control_points.fill(value);
    versions.push_back(std::make_shared<const StoredTile>(tile));
  }
  MapWriter map({0.05, kLimits});
  Layer& layer = map.AddLayer({"robot", 1}, {1, 1});
  map.AddLayer({"robot", 2}, {1, 1});
  for (const uint64_t revision : {2, 4, 4, 1, 5, 3}) {
    layer.RestoreTile({0, 0}, versions[revision - 1], revision);
    layer.RestoreTile({int32_t(revision), 7}, versions[revision - 1], revision);
    // A tile with an old revision that comes late is in the next view, too.
    EXPECT_NE(map.View()->tiles.Find({int32_t(revision), 7}), nullptr);
  }
  EXPECT_EQ(FindTile(map.View()->tiles, {0, 0})->control_points[0], 5);
  EXPECT_EQ(layer.revision(), 5u);
}

TEST(MapViewTest, KnownIsWhereTheNearestControlPointWasTouched) {
  MapWriter map({0.1, kLimits});
  Layer& layer = map.AddLayer({"robot", 1}, {1, 1});
  layer.BeginCommit();
  layer.EditTile({0, 0}).control_points[IndexInTile(3, 5)] = -1;
  const auto view = map.View();
  EXPECT_TRUE(view->Evaluate(0.3, 0.5).known);
  EXPECT_TRUE(view->Evaluate(0.26, 0.54).known);
  EXPECT_FALSE(view->Evaluate(0.24, 0.5).known);
  EXPECT_FALSE(view->Evaluate(0.3, 0.56).known);
}

// Control points one by one, and the plain code of EvaluatePatch().
SurfaceSample SimplyEvaluated(const TileTree& tiles, double x_m, double y_m) {
  constexpr double kKnot = 0.05;
  const auto x = LocateKnot(x_m, kKnot);
  const auto y = LocateKnot(y_m, kKnot);
  if (!x || !y) return {};
  ControlPatch patch = ControlPatch::Zero();
  for (int row = 0; row < 4; ++row) {
    for (int column = 0; column < 4; ++column) {
      const int32_t i = x->index - 1 + column;
      const int32_t j = y->index - 1 + row;
      const auto tile = FindTile(tiles, TileOf(i, j));
      if (tile == nullptr) continue;
      patch(row, column) = tile->control_points[IndexInTile(i, j)] / double{kUnitsPerLogOdds};
    }
  }
  SurfaceSample sample = EvaluatePatch(patch, x->t, y->t, kKnot);
  sample.known = patch(y->t < 0.5 ? 1 : 2, x->t < 0.5 ? 1 : 2) != 0;
  return sample;
}

// Zeros have the same sign, too.
void ExpectSameBytes(const SurfaceSample& sample, const SurfaceSample& expected) {
  ASSERT_EQ(std::bit_cast<uint64_t>(sample.log_odds), std::bit_cast<uint64_t>(expected.log_odds));
  for (int k = 0; k < 2; ++k) {
    ASSERT_EQ(std::bit_cast<uint64_t>(sample.gradient_per_m[k]),
              std::bit_cast<uint64_t>(expected.gradient_per_m[k]));
  }
  ASSERT_EQ(sample.known, expected.known);
}

// At random; on the lines between tiles and beside them; along a path that goes on and off them;
// and off the map in between.
std::vector<Eigen::Vector2d> AllKindsOfPoints(std::mt19937_64& random) {
  std::uniform_real_distribution<double> coordinate_m(-7, 7);
  std::vector<Eigen::Vector2d> points_m = {{std::nan(""), 0}, {0, 1e300}, {1e5, 1e5}, {-0.0, 0.0}};
  while (points_m.size() < 5001) {
    const double x_m = coordinate_m(random);
    points_m.emplace_back(x_m, coordinate_m(random));
  }
  for (int n = -100; n <= 100; ++n) {
    points_m.emplace_back(0.05 * n, coordinate_m(random));
    points_m.emplace_back(1.6 * (n % 4) + 0.01 * n, 0.05 * n);
  }
  std::normal_distribution<double> turn_rad(0, 0.05);
  Eigen::Vector2d point_m(-1, -1);
  double yaw_rad = 0.5;
  for (int n = 0; n < 3000; ++n) {
    points_m.push_back(point_m);
    if (n % 97 == 0) points_m.emplace_back(point_m.x(), std::nan(""));
    yaw_rad += turn_rad(random);
    if (point_m.norm() > 5) yaw_rad = std::atan2(-point_m.y(), -point_m.x());
    point_m += 0.01 * Eigen::Vector2d(std::cos(yaw_rad), std::sin(yaw_rad));
  }
  return points_m;
}

std::shared_ptr<const MapView> RandomView(std::mt19937_64& random) {
  MapWriter map({0.05, kLimits});
  Layer& layer = map.AddLayer({"robot", 1}, {1, 1});
  layer.BeginCommit();
  for (int n = 0; n < 30; ++n) layer.EditTile(RandomKey(random, 3)) = RandomTile(random);
  return map.View();
}

TEST(MapViewTest, ManyPointsAtOnceGiveTheSameBytes) {
  std::mt19937_64 random(5);
  const auto view = RandomView(random);
  const std::vector<Eigen::Vector2d> points_m = AllKindsOfPoints(random);
  std::vector<SurfaceSample> samples(points_m.size());
  view->EvaluateMany(points_m, absl::MakeSpan(samples));
  PathReader reader(view);
  size_t known = 0;
  for (size_t n = 0; n < points_m.size(); ++n) {
    SCOPED_TRACE(points_m[n].transpose());
    const SurfaceSample expected = SimplyEvaluated(view->tiles, points_m[n].x(), points_m[n].y());
    ExpectSameBytes(samples[n], expected);
    ExpectSameBytes(view->Evaluate(points_m[n].x(), points_m[n].y()), expected);
    ExpectSameBytes(reader.Evaluate(points_m[n].x(), points_m[n].y()), expected);
    known += samples[n].known;
  }
  EXPECT_GT(known, points_m.size() / 10);
  EXPECT_LT(known, points_m.size() * 8 / 10);
}

TEST(MapViewTest, BatchesOfEverySizeGiveTheSameBytes) {
  std::mt19937_64 random(6);
  const auto view = RandomView(random);
  const std::vector<Eigen::Vector2d> points_m = AllKindsOfPoints(random);
  size_t begin = 0;
  for (size_t count = 0; begin + count <= points_m.size(); count = (count + 1) % 71) {
    const auto batch_m = absl::MakeConstSpan(points_m).subspan(begin, count);
    std::vector<SurfaceSample> samples(count);
    view->EvaluateMany(batch_m, absl::MakeSpan(samples));
    for (size_t n = 0; n < count; ++n) {
      SCOPED_TRACE(batch_m[n].transpose());
      ExpectSameBytes(samples[n], view->Evaluate(batch_m[n].x(), batch_m[n].y()));
    }
    begin += count;
  }
}

// Has tiles by their numbers.
class ListedTiles : public TileSource {
 public:
  ListedTiles(std::shared_ptr<TileMemory> memory, std::vector<Tile> tiles)
      : TileSource(std::move(memory)), tiles_(std::move(tiles)) {}

  std::shared_ptr<const Tile> Load(int64_t number, uint64_t /*checksum*/) override {
    return is_broken ? nullptr : std::make_shared<const Tile>(tiles_[number - 1]);
  }

  std::atomic<bool> is_broken = false;

 private:
  const std::vector<Tile> tiles_;
};

// A map of 64 tiles, of which 3 are in memory, and the same that is all in memory.
struct TilesThatLeave {
  explicit TilesThatLeave(std::mt19937_64& random) {
    std::vector<Tile> tiles;
    for (int n = 0; n < 64; ++n) tiles.push_back(RandomTile(random));
    source = std::make_shared<ListedTiles>(memory, tiles);
    TileTreeEditor stored;
    TileTreeEditor in_memory;
    for (int64_t n = 0; n < 64; ++n) {
      const TileKey key{static_cast<int32_t>(n % 8 - 4), static_cast<int32_t>(n / 8 - 4)};
      stored.Put(key, std::make_shared<const StoredTile>(source, n + 1), 1);
      in_memory.Put(key, std::make_shared<const StoredTile>(tiles[n]), 1);
    }
    view = std::make_shared<const MapView>(MapView{{0.05, kLimits}, 1, stored.Freeze()});
    expected = std::make_shared<const MapView>(MapView{{0.05, kLimits}, 1, in_memory.Freeze()});
  }

  const std::shared_ptr<TileMemory> memory = std::make_shared<TileMemory>(3);
  std::shared_ptr<ListedTiles> source;
  std::shared_ptr<const MapView> view;
  std::shared_ptr<const MapView> expected;
};

TEST(MapViewTest, TilesThatLeaveMemoryGiveTheSameBytes) {
  std::mt19937_64 random(7);
  const TilesThatLeave map(random);
  const std::vector<Eigen::Vector2d> points_m = AllKindsOfPoints(random);
  std::vector<SurfaceSample> samples(points_m.size());
  map.view->EvaluateMany(points_m, absl::MakeSpan(samples));
  PathReader reader(map.view);
  for (size_t n = 0; n < points_m.size(); ++n) {
    const SurfaceSample sample = map.expected->Evaluate(points_m[n].x(), points_m[n].y());
    ExpectSameBytes(samples[n], sample);
    ExpectSameBytes(map.view->Evaluate(points_m[n].x(), points_m[n].y()), sample);
    ExpectSameBytes(reader.Evaluate(points_m[n].x(), points_m[n].y()), sample);
  }
  EXPECT_LE(map.memory->num_tiles(), 3u);
}

TEST(MapViewTest, ManyThreadsEvaluateWhileTilesLeaveMemory) {
  std::mt19937_64 random(8);
  const TilesThatLeave map(random);
  const std::vector<Eigen::Vector2d> points_m = AllKindsOfPoints(random);
  std::vector<SurfaceSample> expected(points_m.size());
  map.expected->EvaluateMany(points_m, absl::MakeSpan(expected));
  std::vector<std::jthread> threads;
  for (int k = 0; k < 3; ++k) {
    threads.emplace_back([&] {
      std::vector<SurfaceSample> samples(points_m.size());
      map.view->EvaluateMany(points_m, absl::MakeSpan(samples));
      for (size_t n = 0; n < points_m.size(); ++n) {
        ExpectSameBytes(samples[n], expected[n]);
        ExpectSameBytes(map.view->Evaluate(points_m[n].x(), points_m[n].y()), expected[n]);
      }
    });
  }
}

TEST(MapViewTest, ATileThatCannotBeReadIsReadWhenItCan) {
  std::mt19937_64 random(9);
  const TilesThatLeave map(random);
  const Eigen::Vector2d point_m(0.8, 0.8);
  map.source->is_broken = true;
  ExpectSameBytes(map.view->Evaluate(point_m.x(), point_m.y()), {});
  map.source->is_broken = false;
  const SurfaceSample expected = map.expected->Evaluate(point_m.x(), point_m.y());
  EXPECT_NE(expected.log_odds, 0);
  ExpectSameBytes(map.view->Evaluate(point_m.x(), point_m.y()), expected);
}

TEST(MapViewTest, FarAndUndefinedPointsAreUnknown) {
  MapWriter map({0.05, kLimits});
  map.AddLayer({"robot", 1}, {1, 1});
  const auto view = map.View();
  for (const double x : {std::nan(""), 1e300, -std::numeric_limits<double>::infinity(), 1e5}) {
    const SurfaceSample sample = view->Evaluate(x, 0);
    EXPECT_FALSE(sample.known);
    EXPECT_EQ(sample.log_odds, 0);
    EXPECT_EQ(sample.gradient_per_m.norm(), 0);
  }
}

// Every commit writes its number into all of four tiles; no reader may see two numbers.
TEST(MapViewTest, ReadersNeverSeeHalfACommit) {
  MapWriter map({0.05, kLimits});
  Layer& layer = map.AddLayer({"robot", 1}, {1, 1});
  Mutex mutex;
  std::shared_ptr<const MapView> newest = map.View();
  std::atomic<bool> done = false;
  std::atomic<int> torn = 0;
  std::atomic<int> read = 0;
  const auto reader = [&] {
    while (!done) {
      std::shared_ptr<const MapView> view;
      {
        MutexLock lock(mutex);
        view = newest;
      }
      const auto commit = static_cast<ControlPoint>(view->revision);
      view->tiles.ForEach([&](TileKey, const TileTree::Entry& entry) {
        const auto tile = entry.tile->Get();
        for (const ControlPoint c : tile->control_points) torn += c != commit;
      });
      ++read;
    }
  };
  std::vector<std::jthread> readers;
  for (int k = 0; k < 3; ++k) readers.emplace_back(reader);
  for (int commit = 1; commit <= 2000; ++commit) {
    layer.BeginCommit();
    for (const TileKey key : {TileKey{0, 0}, TileKey{-1, 0}, TileKey{40, 3}, TileKey{0, -9}}) {
      layer.EditTile(key).control_points.fill(static_cast<ControlPoint>(commit));
    }
    auto view = map.View();
    MutexLock lock(mutex);
    newest = std::move(view);
  }
  while (read < 10) std::this_thread::yield();
  done = true;
  readers.clear();
  EXPECT_EQ(torn, 0);
}

}  // namespace splinemap::map_view_test
