// The sum of layers that are together far larger than the caches, beside a memcpy that
// reads and writes as many bytes.
#include <benchmark/benchmark.h>

#include <cstring>
#include <memory>
#include <random>
#include <string>
#include <vector>

#include "lib/tiles/sum_tiles.h"
#include "tests/bench/speed/benchmarks.h"
#include "tests/support/random_map.h"

namespace splinemap::bench {
namespace {

struct Layers {
  Layers(size_t num_layers, size_t num_tiles) : tiles(num_layers) {
    std::mt19937_64 random(1);
    std::vector<Tile> contents;
    for (int n = 0; n < 61; ++n) contents.push_back(RandomTile(random));
    size_t n = 0;
    for (std::vector<Tile>& layer : tiles) {
      while (layer.size() < num_tiles) layer.push_back(contents[n++ % contents.size()]);
    }
    sums.resize(num_tiles);
  }

  int64_t bytes() const {
    return static_cast<int64_t>((tiles.size() + 1) * sums.size() * sizeof(Tile));
  }

  std::vector<std::vector<Tile>> tiles;
  std::vector<Tile> sums;
};

void Sum(Layers& layers) {
  std::vector<const Tile*> tiles(layers.tiles.size());
  for (size_t n = 0; n < layers.sums.size(); ++n) {
    for (size_t k = 0; k < tiles.size(); ++k) tiles[k] = &layers.tiles[k][n];
    layers.sums[n] = SumTiles(tiles, {});
  }
}

void RegisterMergingOf(size_t num_layers, size_t num_tiles) {
  const auto layers = std::make_shared<Layers>(num_layers, num_tiles);
  const std::string name = "merging/" + std::to_string(num_layers) + "_layers/";
  benchmark::RegisterBenchmark((name + "splinemap").c_str(), [layers](benchmark::State& state) {
    for (auto _ : state) {
      Sum(*layers);
      benchmark::ClobberMemory();
    }
    state.SetBytesProcessed(state.iterations() * layers->bytes());
  });
  benchmark::RegisterBenchmark((name + "memcpy").c_str(), [layers](benchmark::State& state) {
    std::vector<char> from(layers->bytes() / 2, 1);
    std::vector<char> to(from.size());
    for (auto _ : state) {
      std::memcpy(to.data(), from.data(), from.size());
      benchmark::ClobberMemory();
    }
    state.SetBytesProcessed(state.iterations() * layers->bytes());
  });
}

}  // namespace

void RegisterMerging(size_t num_tiles) {
  RegisterMergingOf(8, num_tiles);
  RegisterMergingOf(32, num_tiles / 4);  // the same bytes
}

}  // namespace splinemap::bench
