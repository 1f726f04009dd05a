#pragma once

#include <cstdint>
#include <optional>

#include "splinemap/beam_model_options.h"

namespace splinemap {

// What packed scans may say.
inline constexpr float kMaxRange_m = 1000;
inline constexpr uint32_t kMaxChannel = 1023;
inline bool CanBe(const BeamModelOptions& model) {
  return model.update >= BeamUpdate::kSignedDistance && model.update <= BeamUpdate::kPaperLine &&
         model.kappa_hit >= 0 && model.kappa_hit <= kMaxKappaHit && model.kappa_free <= 0 &&
         model.kappa_free >= kMinKappaFree &&
         model.free_sample_spacing_knots >= kMinFreeSampleSpacingKnots &&
         model.free_sample_spacing_knots <= 1000;
}

// What ranges are whole numbers of, mostly: centimetres, millimetres, quarters of them.
inline constexpr uint32_t kRangeUnits_um[] = {10'000, 1'000, 250};
inline float RangeOf(int32_t units, uint32_t unit_um) {
  return static_cast<float>(double{1} * units * unit_um * 1e-6);
}

}  // namespace splinemap
