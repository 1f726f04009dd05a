// No way of mapping a scan is faster than to read, add to and write each control point that it
// changes, once, in the order of the tiles. What a scan changes is worked out beforehand, by
// committing it to an empty layer, and lies in memory in the order in which it is used.
#include <algorithm>
#include <array>
#include <memory>
#include <vector>

#include "absl/container/flat_hash_map.h"
#include "tests/bench/speed/benchmarks.h"
#include "tests/bench/speed/insertion.h"

namespace splinemap::bench {
namespace {

constexpr ControlLimits kLimits;

struct PointChange {
  uint16_t index = 0;  // in its tile
  ControlPoint change = 0;
};

// Half a row of a tile, 32 bytes, where any of it changes.
struct VectorChange {
  static constexpr int kSize = 16;
  std::array<ControlPoint, kSize> changes{};
  uint16_t index = 0;  // in its tile, of the first
};

struct TileChange {
  size_t tile = 0;  // in the map
  size_t points_end = 0;
  size_t vectors_end = 0;
};

// All changes of a drive. Each tile's begin where those of the one before end.
struct Changes {
  size_t num_scans = 0;
  size_t num_tiles = 0;
  std::vector<TileChange> tiles;
  std::vector<PointChange> points;
  std::vector<VectorChange> vectors;
};

void Append(size_t number, const Tile& tile, Changes& changes) {
  for (int begin = 0; begin < Tile::kSize; begin += VectorChange::kSize) {
    VectorChange vector{{}, static_cast<uint16_t>(begin)};
    const size_t points_before = changes.points.size();
    for (int k = 0; k < VectorChange::kSize; ++k) {
      const ControlPoint change = tile.control_points[begin + k];
      vector.changes[k] = change;
      if (change != 0) changes.points.push_back({static_cast<uint16_t>(begin + k), change});
    }
    if (changes.points.size() > points_before) changes.vectors.push_back(vector);
  }
  changes.tiles.push_back({number, changes.points.size(), changes.vectors.size()});
}

Changes ChangesOf(const Workload& workload, const BeamModelOptions& options) {
  Changes changes;
  absl::flat_hash_map<TileKey, size_t> numbers;
  SplineMapper mapper(options);
  for (const RecordedScan& scan : workload.scans) {
    mapper.Clear();
    mapper.Insert(scan);
    mapper.layer().tiles().ForEach([&](TileKey key, const TileTree::Entry& entry) {
      Append(numbers.try_emplace(key, numbers.size()).first->second, *entry.tile->Get(), changes);
    });
  }
  changes.num_scans = workload.scans.size();
  changes.num_tiles = numbers.size();
  return changes;
}

ControlPoint Sum(ControlPoint control_point, ControlPoint change) {
  return static_cast<ControlPoint>(
      std::clamp<int>(control_point + change, kLimits.min, kLimits.max));
}

void AddPoints(const Changes& changes, std::vector<Tile>& tiles) {
  size_t n = 0;
  for (const TileChange& change : changes.tiles) {
    Tile& tile = tiles[change.tile];
    for (; n < change.points_end; ++n) {
      ControlPoint& c = tile.control_points[changes.points[n].index];
      c = Sum(c, changes.points[n].change);
    }
  }
}

// The best that vector instructions can do, without looking for what is zero in half a row.
__attribute__((target_clones("avx2", "default")))  //
void AddVectors(const Changes& changes, std::vector<Tile>& tiles) {
  size_t n = 0;
  for (const TileChange& change : changes.tiles) {
    Tile& tile = tiles[change.tile];
    for (; n < change.vectors_end; ++n) {
      const VectorChange& vector = changes.vectors[n];
      ControlPoint* c = &tile.control_points[vector.index];
      for (int k = 0; k < VectorChange::kSize; ++k) c[k] = Sum(c[k], vector.changes[k]);
    }
  }
}

void TimeLimit(benchmark::State& state, const Changes& changes,
               void (*add)(const Changes&, std::vector<Tile>&)) {
  std::vector<Tile> tiles(changes.num_tiles);
  for (auto _ : state) {
    add(changes, tiles);
    benchmark::ClobberMemory();
  }
  state.SetItemsProcessed(state.iterations() * static_cast<int64_t>(changes.num_scans));
  state.counters["points_per_scan"] =
      static_cast<double>(changes.points.size()) / static_cast<double>(changes.num_scans);
}

}  // namespace

void RegisterLimit(const Workload& workload) {
  for (const SplineVariant& variant : SplineVariants()) {
    if (&variant.kernel != &FastestScanKernel()) continue;  // they change the same
    const auto changes = std::make_shared<Changes>(ChangesOf(workload, variant.options));
    const std::string name = "insertion/" + workload.name + "/limit_of_" + variant.name;
    benchmark::RegisterBenchmark(name.c_str(), [changes](benchmark::State& state) {
      TimeLimit(state, *changes, AddPoints);
    });
    benchmark::RegisterBenchmark(
        (name + "_in_vectors").c_str(),
        [changes](benchmark::State& state) { TimeLimit(state, *changes, AddVectors); });
  }
}

}  // namespace splinemap::bench
