#include "tests/bench/speed/insertion.h"

#include "tests/bench/speed/benchmarks.h"
#include "tests/support/map_writer.h"

namespace splinemap::bench {

std::vector<SplineVariant> SplineVariants() {
  std::vector<SplineVariant> variants{{"splinemap", {}}};
  for (const ScanKernel& kernel : ScanKernels()) {
    if (&kernel != &FastestScanKernel()) {
      variants.push_back({std::string("splinemap_") + kernel.name, {}, kernel});
    }
  }
  variants.push_back({"splinemap_samples", {.update = BeamUpdate::kPaperSamples}});
  return variants;
}

void SplineMapper::Clear() {
  map_ = MapWriter({.knot_interval_m = kResolution_m, .limits = {}});
  layer_ = &map_.AddLayer({"bench", 1}, {1, 1});
}

void SplineMapper::Insert(const RecordedScan& scan) {
  Place(scan.scan.beams, {&scan.world_T_sensor, 1}, beams_);
  model_.Accumulate(beams_, scratch_);
  scratch_.CommitTo(*layer_, map_.options().limits);
}

void RegisterInsertion(const Workload& workload) {
  for (const SplineVariant& variant : SplineVariants()) {
    const std::string name = "insertion/" + workload.name + "/" + variant.name;
    const auto make = [variant] {
      return std::make_unique<SplineMapper>(variant.options, variant.kernel);
    };
    benchmark::RegisterBenchmark(name.c_str(), [&workload, make](benchmark::State& state) {
      TimeInsertion(state, workload, make, [&workload](SplineMapper& mapper, size_t n) {
        mapper.Insert(workload.scans[n]);
      });
    });
    // As for a subscriber of every commit.
    benchmark::RegisterBenchmark(
        (name + "_with_snapshots").c_str(), [&workload, make](benchmark::State& state) {
          std::shared_ptr<const MapView> view;
          TimeInsertion(state, workload, make, [&](SplineMapper& mapper, size_t n) {
            mapper.Insert(workload.scans[n]);
            view = mapper.map().View();
          });
        });
  }
}

}  // namespace splinemap::bench
