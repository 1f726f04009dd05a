#pragma once

#include <optional>

#include "absl/status/status.h"
#include "lib/mapping/beam_model.h"
#include "lib/mapping/scan_scratch.h"
#include "splinemap/layer_set.h"
#include "splinemap/posed_scan.h"

namespace splinemap {

// Adds scans to layers, each in one commit: live as they come, and from archives. What comes out
// depends on the scans, their order and the options alone. Thread-compatible.
class ScanFolder {
 public:
  explicit ScanFolder(const MapOptions& options, const ScanKernel& kernel = FastestScanKernel())
      : options_(options), kernel_(kernel), scratch_(kernel) {}

  // InvalidArgument where a beam is longer than kMaxReachKnots, all of them together are too long,
  // the sensor moves too far meanwhile, or the scan lies beyond kMaxKnotIndex.
  absl::Status Check(const PlacedScan& scan) const;
  // Requires Check().
  void Fold(const PlacedScan& scan, const BeamModelOptions& model, Layer& layer);
  // The same into those tiles for which `is_taken` is true, which is asked once for each that would
  // change; changes are stamped with `revision`.
  void Fold(const PlacedScan& scan, const BeamModelOptions& model, uint64_t revision,
            TileTreeEditor& tiles, absl::FunctionRef<bool(TileKey)> is_taken);

  // Fold() in two steps: what needs no layer, and, in another folder and thread if need be, what
  // does, which takes the lines.
  void Prepare(const PlacedScan& scan, const BeamModelOptions& model, ScanLines& lines);
  void FoldPrepared(const PlacedScan& scan, const BeamModelOptions& model, ScanLines& lines,
                    Layer& layer);

  const MapOptions& options() const { return options_; }

  static constexpr double kMaxReachKnots = 4096;
  // Robots further out are refused, so that no beam leaves the range of kMaxKnotIndex.
  static double MaxCoordinate_m(const MapOptions& options);

 private:
  void Accumulate(const PlacedScan& scan, const BeamModelOptions& model);
  BeamModel& ModelOf(const BeamModelOptions& model);

  MapOptions options_;
  const ScanKernel& kernel_;
  BeamModelOptions model_options_;
  std::optional<BeamModel> model_;  // of model_options_
  ScanScratch scratch_;
};

}  // namespace splinemap
