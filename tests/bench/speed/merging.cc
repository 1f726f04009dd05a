// The sum of layers that are together far larger than the caches, beside memcpy of tiles that reads
// and writes as many bytes.
#include <benchmark/benchmark.h>

#include <algorithm>
#include <cstring>
#include <functional>
#include <memory>
#include <random>
#include <string>
#include <vector>

#include "lib/tiles/sum_tiles.h"
#include "tests/bench/speed/benchmarks.h"
#include "tests/support/random_map.h"

namespace splinemap::bench {
namespace {

// Tiles in the order in which they lie in memory, which is that of no map.
struct Layers {
  Layers(size_t layers, size_t num_sums) : num_layers(layers), tiles(layers * num_sums) {
    std::mt19937_64 random(1);
    std::vector<Tile> contents;
    for (int n = 0; n < 61; ++n) contents.push_back(RandomTile(random));
    for (size_t n = 0; n < tiles.size(); ++n) tiles[n] = contents[n % contents.size()];
    sums.resize(num_sums);
    for (const Tile& tile : tiles) order.push_back(&tile);
    std::shuffle(order.begin(), order.end(), random);
    for (Tile& sum : sums) order_of_sums.push_back(&sum);
    std::shuffle(order_of_sums.begin(), order_of_sums.end(), random);
  }

  size_t num_layers;
  std::vector<Tile> tiles;
  std::vector<Tile> sums;
  std::vector<const Tile*> order;  // those of a sum one after the other
  std::vector<Tile*> order_of_sums;
};

void Sum(const Layers& layers) {
  std::vector<const Tile*> tiles(layers.num_layers);
  for (size_t n = 0; n < layers.sums.size(); ++n) {
    std::copy_n(&layers.order[n * layers.num_layers], layers.num_layers, tiles.begin());
    *layers.order_of_sums[n] = SumTiles(tiles, {});
  }
}

void RegisterMergingOf(size_t num_layers, size_t num_sums) {
  const std::string name = "merging/" + std::to_string(num_layers) + "_layers/";
  const size_t num_tiles = (num_layers + 1) * num_sums;  // read and written
  const auto register_as = [&](const char* competitor, const std::function<void()>& run) {
    benchmark::RegisterBenchmark((name + competitor).c_str(), [run,
                                                               num_tiles](benchmark::State& state) {
      for (auto _ : state) {
        run();
        benchmark::ClobberMemory();
      }
      state.SetBytesProcessed(state.iterations() * static_cast<int64_t>(num_tiles * sizeof(Tile)));
    });
  };
  const auto layers = std::make_shared<const Layers>(num_layers, num_sums);
  register_as("splinemap", [layers] { Sum(*layers); });
  // As many tiles are copied, one by one, in the same disorder.
  const auto copied = std::make_shared<const Layers>(1, num_tiles / 2);
  register_as("memcpy", [copied] {
    for (size_t n = 0; n < copied->order.size(); ++n) {
      std::memcpy(copied->order_of_sums[n], copied->order[n], sizeof(Tile));
    }
  });
}

}  // namespace

void RegisterMerging(size_t num_tiles) {
  RegisterMergingOf(8, num_tiles);
  RegisterMergingOf(32, num_tiles / 4);  // the same bytes
}

}  // namespace splinemap::bench
