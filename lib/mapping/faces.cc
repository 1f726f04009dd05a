#include "lib/mapping/faces.h"

#include <algorithm>
#include <cmath>

#include "lib/mapping/beam_memory.h"

namespace splinemap {
namespace {

// Rows of control points up to so far behind the face take part in it: one at least that lies half
// a knot behind. Of what is narrow more, since beams that pass it take them away again.
constexpr double kBehindKnots = 1.5;
constexpr double kBehindNarrowKnots = 1.75;
static_assert(SignedDistance::kFrontKnots / Face::kLeastCosine + 1 + kBehindNarrowKnots <=
              FaceLine::kMostRows - 1);
// Things narrower than that weigh more.
constexpr double kWideKnots = 6;

}  // namespace

absl::Span<const Face> FaceFinder::Find(absl::Span<const PlacedBeam> beams) {
  SetHits(beams);
  chords_.resize(beams.size());
  faces_.resize(beams.size());
  for (size_t k = 0; k < beams.size();) {
    if (!beams[k].hit) {
      chords_[k++] = {};
      continue;
    }
    Run run{k, k + 1};
    while (run.end < beams.size() && is_beside_[run.end] != 0) ++run.end;
    SetChords(run, WeightOf(beams, run));
    k = run.end;
  }
  kernel_.set_faces(MemoryOf(beams), chords_.data(), beams.size(), faces_.data());
  return faces_;
}

void FaceFinder::SetHits(absl::Span<const PlacedBeam> beams) {
  const size_t count = beams.size() + Hits::kMore;
  x_.resize(count);
  y_.resize(count);
  spacings_.resize(count);
  aside_.resize(count);
  is_beside_.resize(count);
  kernel_.set_hits(MemoryOf(beams), beams.size(), knots_per_m_,
                   {x_.data(), y_.data(), spacings_.data(), aside_.data(), is_beside_.data()});
}

int FaceFinder::WeightOf(absl::Span<const PlacedBeam> beams, const Run& run) const {
  // Where something hides a part of the surface, or the scan ends, its width is not known.
  if (run.begin == 0 || run.end == beams.size()) return kFaceWeight;
  if (beams[run.begin - 1].range_m <= beams[run.begin].range_m ||
      beams[run.end].range_m <= beams[run.end - 1].range_m) {
    return kFaceWeight;
  }
  const Eigen::Vector2d across(x_[run.begin] - x_[run.end - 1], y_[run.begin] - y_[run.end - 1]);
  const double width = across.norm() + spacings_[run.begin];
  const double weight = kFaceWeight * kWideKnots / std::max(width, 0.1);
  return static_cast<int>(std::clamp<double>(weight, kFaceWeight, kMostFaceWeight));
}

void FaceFinder::SetChords(const Run& run, int weight) {
  const double behind = weight > kFaceWeight ? kBehindNarrowKnots : kBehindKnots;
  for (size_t k = run.begin; k < run.end; ++k) {
    const auto aside = static_cast<size_t>(aside_[k]);
    const size_t last = std::min(k + aside, run.end - 1);
    const size_t first = std::max(k, run.begin + aside) - aside;
    chords_[k] = {{x_[last] - x_[first], y_[last] - y_[first]}, behind, weight};
  }
}

}  // namespace splinemap
