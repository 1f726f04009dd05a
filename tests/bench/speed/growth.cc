// What a scan and a snapshot cost in maps of growing size, and what a tile takes in memory.
#include <benchmark/benchmark.h>
#include <malloc.h>

#include <memory>
#include <string>

#include "tests/bench/speed/benchmarks.h"
#include "tests/bench/speed/insertion.h"
#include "tests/bench/speed/tile_square.h"

namespace splinemap::bench {
namespace {

double AllocatedBytes() {
  const struct mallinfo2 info = mallinfo2();
  return static_cast<double>(info.uordblks + info.hblkhd);
}

struct LargeMap {
  explicit LargeMap(size_t num_tiles) : mapper({}) {
    const double bytes_before = AllocatedBytes();
    TileSquare(num_tiles).CommitTo(mapper.layer());
    bytes_per_tile =
        (AllocatedBytes() - bytes_before) / static_cast<double>(mapper.layer().tiles().size());
  }

  SplineMapper mapper;
  double bytes_per_tile;
};

void Grow(benchmark::State& state, const Workload& workload, LargeMap& map, bool take_snapshots) {
  std::shared_ptr<const MapView> view;
  size_t n = 0;
  for (auto _ : state) {
    map.mapper.Insert(workload.scans[n]);
    if (take_snapshots) view = map.mapper.map().View();
    n = (n + 1) % workload.scans.size();
  }
  state.SetItemsProcessed(state.iterations());
  state.counters["tiles"] = static_cast<double>(map.mapper.layer().tiles().size());
  state.counters["bytes_per_tile"] = map.bytes_per_tile;
}

}  // namespace

void RegisterGrowth(const Workload& workload, size_t max_tiles) {
  for (const size_t num_tiles : {1'000, 10'000, 100'000, 400'000}) {
    if (num_tiles > max_tiles) break;
    const auto map = std::make_shared<LargeMap>(num_tiles);
    for (const bool take_snapshots : {false, true}) {
      const std::string name = "growth/" + std::to_string(num_tiles) + "_tiles/scan" +
                               (take_snapshots ? "_and_snapshot" : "");
      benchmark::RegisterBenchmark(name.c_str(),
                                   [&workload, map, take_snapshots](benchmark::State& state) {
                                     Grow(state, workload, *map, take_snapshots);
                                   });
    }
  }
}

}  // namespace splinemap::bench
