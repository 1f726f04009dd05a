#pragma once

namespace splinemap {

// What a beam says of the control points around it.
enum class BeamUpdate {
  kSignedDistance,  // how far they lie before or behind the face that it hits
  kPaperSamples,    // the paper's (8) and (9): log-odds, those of free space at points that lie
                    // free_sample_spacing_knots apart
  kPaperLine,       // the expectation of that over the phase of the points
};

struct BeamModelOptions {
  BeamUpdate update = BeamUpdate::kSignedDistance;
  // Of the paper's updates.
  double kappa_hit = 0.9;                   // log-odds that a hit adds to the surface at its point
  double kappa_free = -0.3;                 // log-odds that a free sample adds
  double free_sample_spacing_knots = 1.41;  // distance of the free samples along a beam
  bool operator==(const BeamModelOptions&) const = default;
};

// Limits within which the sums of a scan cannot overflow; see ScanScratch.
inline constexpr double kMaxKappaHit = 4;
inline constexpr double kMinKappaFree = -1.5;
inline constexpr double kMinFreeSampleSpacingKnots = 1;

}  // namespace splinemap
