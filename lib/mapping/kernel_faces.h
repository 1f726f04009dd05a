#pragma once

// What beams hit, and the faces of that. A part of scan_kernel_impl.h.

#include "lib/mapping/kernel_lanes.h"

namespace splinemap::SPLINEMAP_KERNEL {
namespace {

// Four beams.
struct PlacedFour {
  Doubles4 x;  // in knots
  Doubles4 y;
  Doubles4 dx;
  Doubles4 dy;
  Doubles4 range;
};

[[gnu::always_inline]] inline PlacedFour LoadPlaced(const BeamMemory* beams, double knots_per_m) {
  static_assert(offsetof(BeamMemory, direction_world) == 2 * sizeof(double));
  Doubles4 beam[4];  // origin and direction
  Doubles4 range_m;
  for (int k = 0; k < 4; ++k) {
    beam[k] = Load<Doubles4>(&beams[k]);
    range_m[k] = beams[k].range_m;
  }
  Transpose(beam);
  return {beam[0] * knots_per_m, beam[1] * knots_per_m, beam[2], beam[3], range_m * knots_per_m};
}

// Of the four beams before.
struct HitsBefore {
  Doubles4 x;
  Doubles4 y;
  Doubles4 spacing;
};

// Of four beams and the one after them.
[[gnu::always_inline]] inline HitsBefore SetFourHits(const BeamMemory* beams, double knots_per_m,
                                                     const HitsBefore& before, const Hits& hits,
                                                     size_t n) {
  const PlacedFour four = LoadPlaced(beams, knots_per_m);
  const Doubles4 last = Load<Doubles4>(&beams[4]);
  const Doubles4 next_dx = __builtin_shufflevector(four.dx, last, 1, 2, 3, 6);
  const Doubles4 next_dy = __builtin_shufflevector(four.dy, last, 1, 2, 3, 7);
  const Doubles4 x = four.x + four.range * four.dx;
  const Doubles4 y = four.y + four.range * four.dy;
  const Doubles4 spacing = four.range * Abs(four.dx * next_dy - four.dy * next_dx);
  Store(x, hits.x + n);
  Store(y, hits.y + n);
  Store(spacing, hits.spacing + n);

  // The same to either side as far as the hits lie apart, one at least.
  const Doubles4 most = Doubles4{} + (Hits::kMostAside - 1);
  const Doubles4 aside = Hits::kHalfChordKnots / spacing;
  Store(__builtin_convertvector(Lesser(aside, most), Integers4) + 1, hits.aside + n);

  const Doubles4 x_step = x - __builtin_shufflevector(before.x, x, 3, 4, 5, 6);
  const Doubles4 y_step = y - __builtin_shufflevector(before.y, y, 3, 4, 5, 6);
  const Doubles4 oblique =
      Hits::kMostObliqueGap * __builtin_shufflevector(before.spacing, spacing, 3, 4, 5, 6);
  const Doubles4 gap = Greater(oblique, Doubles4{} + Hits::kNearKnots);
  const Longs4 is_near = IsLess(x_step * x_step + y_step * y_step, gap * gap);
  Integers4 hit;
  for (int k = 0; k < 4; ++k) hit[k] = beams[k].hit ? -1 : 0;
  Store(__builtin_convertvector(is_near, Integers4) & hit, hits.is_beside + n);
  return {x, y, spacing};
}

void SetHits(const BeamMemory* beams, size_t count, double knots_per_m, const Hits& hits) {
  HitsBefore before{};
  size_t n = 0;
  for (; n + 5 <= count; n += 4) before = SetFourHits(beams + n, knots_per_m, before, hits, n);
  for (; n < count; n += 4) {
    BeamMemory last[5] = {};
    for (size_t k = 0; k < 5 && n + k < count; ++k) last[k] = beams[n + k];
    // The last beam's spacing is that to the one before.
    if (count < n + 5) last[count - n] = beams[count > 1 ? count - 2 : 0];
    before = SetFourHits(last, knots_per_m, before, hits, n);
  }
}

void SetFourFaces(const BeamMemory* beams, const Chord* chords, Face* faces) {
  constexpr double kBefore = SignedDistance::kFrontKnots;
  static_assert(offsetof(Chord, behind_knots) == 2 * sizeof(double));
  static_assert(offsetof(Face, behind_knots) == 3 * sizeof(double));
  Doubles4 chord[4];
  Doubles4 beam[4];
  Integers4 weight;
  for (int k = 0; k < 4; ++k) {
    chord[k] = Load<Doubles4>(&chords[k]);
    beam[k] = Load<Doubles4>(&beams[k]);
    weight[k] = chords[k].weight;
  }
  Transpose(chord);
  Transpose(beam);
  const Doubles4 dx = beam[2];
  const Doubles4 dy = beam[3];
  const Doubles4 squared_length = chord[0] * chord[0] + chord[1] * chord[1];
  const Longs4 is_lone =
      IsLess(squared_length, Doubles4{} + Face::kLeastChordKnots * Face::kLeastChordKnots);
  const Doubles4 scale = 1 / SquareRoot(Select(is_lone, Doubles4{} + 1, squared_length));
  const Doubles4 x = -chord[1] * scale;
  const Doubles4 y = chord[0] * scale;
  const Doubles4 cosine = x * dx + y * dy;
  const Longs4 is_away = IsLess(cosine, Doubles4{});
  const Doubles4 stretch = 1 / Greater(Abs(cosine), Doubles4{} + Face::kLeastCosine);
  const Longs4 is_face = __builtin_convertvector(weight != 0, Longs4);
  // Control points one knot from the plane in front, and a row more.
  const Doubles4 before = Select(is_lone, Doubles4{} + 1, stretch) * kBefore + 1;
  Doubles4 face[4] = {Select(is_lone, dx, Select(is_away, -x, x)),
                      Select(is_lone, dy, Select(is_away, -y, y)),
                      Select(is_face, before, Doubles4{}), chord[2]};
  Transpose(face);
  for (int k = 0; k < 4; ++k) {
    Store(face[k], &faces[k]);
    faces[k].weight = weight[k];
  }
}

void SetFaces(const BeamMemory* beams, const Chord* chords, size_t count, Face* faces) {
  size_t n = 0;
  for (; n + 4 <= count; n += 4) SetFourFaces(beams + n, chords + n, faces + n);
  if (n == count) return;
  BeamMemory last[4] = {};
  Chord last_chords[4] = {};
  Face last_faces[4];
  __builtin_memcpy(last, beams + n, (count - n) * sizeof *beams);
  __builtin_memcpy(last_chords, chords + n, (count - n) * sizeof *chords);
  SetFourFaces(last, last_chords, last_faces);
  __builtin_memcpy(faces + n, last_faces, (count - n) * sizeof *faces);
}

}  // namespace
}  // namespace splinemap::SPLINEMAP_KERNEL
