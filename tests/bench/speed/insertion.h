#pragma once

#include <benchmark/benchmark.h>

#include <memory>
#include <string>
#include <vector>

#include "lib/mapping/beam_model.h"
#include "lib/mapping/scan_scratch.h"
#include "splinemap/map_view.h"
#include "tests/bench/speed/workload.h"
#include "tests/support/map_writer.h"

namespace splinemap::bench {

// What splinemap can be told to do, by the name that it has in benchmarks; each instruction set but
// the fastest has a name of its own.
struct SplineVariant {
  std::string name;
  BeamModelOptions options;
  const ScanKernel& kernel = FastestScanKernel();
};
std::vector<SplineVariant> SplineVariants();

// From placed beams on this is the way of a scan through the daemon.
class SplineMapper {
 public:
  explicit SplineMapper(const BeamModelOptions& options,
                        const ScanKernel& kernel = FastestScanKernel())
      : model_(options, kResolution_m, kernel), scratch_(kernel) {
    Clear();
  }

  // Begins with an empty map again.
  void Clear();
  void Insert(const RecordedScan& scan);

  MapWriter& map() { return map_; }
  Layer& layer() { return *layer_; }

 private:
  MapWriter map_{{}};
  BeamModel model_;
  ScanScratch scratch_;
  std::vector<PlacedBeam> beams_;
  Layer* layer_ = nullptr;
};

// Times `insert` (mapper, scan index) over the whole drive, into a fresh map each time; making and
// freeing maps is not timed.
template <typename Make, typename Insert>
void TimeInsertion(benchmark::State& state, const Workload& workload, Make make, Insert insert) {
  for (auto _ : state) {
    state.PauseTiming();
    auto mapper = make();
    state.ResumeTiming();
    for (size_t n = 0; n < workload.scans.size(); ++n) insert(*mapper, n);
    benchmark::ClobberMemory();
    state.PauseTiming();
    mapper.reset();
    state.ResumeTiming();
  }
  state.SetItemsProcessed(state.iterations() * static_cast<int64_t>(workload.scans.size()));
}

}  // namespace splinemap::bench
