#pragma once

// Sums brought together and committed. A part of scan_kernel_impl.h.

#include "lib/mapping/kernel_lanes.h"

namespace splinemap::SPLINEMAP_KERNEL {
namespace {

// Of faces, four sums are all that they reach.
template <typename Sum>
void MoveApron(Sum* apron, uint32_t groups, Sum* to) {
  for (int row = 0; row < kSide; ++row, apron += kStride<Sum>, to += kStride<Sum>) {
    if ((groups >> (row / kRowsPerGroup) & 1) == 0) continue;
    AddTo(Load<Row<Sum>>(apron), to);
    Store(Row<Sum>{}, apron);
  }
}

// Likewise, three times.
template <typename Vector>
[[gnu::always_inline]] inline void Transpose(Vector (&r)[8]) {
  for (int step = 0; step < 3; ++step) {
    Vector t[8];
    for (int k = 0; k < 4; ++k) {
      t[2 * k] = __builtin_shufflevector(r[k], r[k + 4], 0, 8, 1, 9, 2, 10, 3, 11);
      t[2 * k + 1] = __builtin_shufflevector(r[k], r[k + 4], 4, 12, 5, 13, 6, 14, 7, 15);
    }
    for (int k = 0; k < 8; ++k) r[k] = t[k];
  }
}

template <typename Sum>
void MoveTransposed(Sum* from, uint32_t groups, Sum* to) {
  constexpr int kGroupsOfEight = (1 << (8 / kRowsPerGroup)) - 1;
  for (int y = 0; y < kSide; y += 8) {
    if ((groups >> (y / kRowsPerGroup) & kGroupsOfEight) == 0) continue;
    for (int x = 0; x < kSide; x += 8) {
      Sum* source = from + y * kStride<Sum> + x;
      Row<Sum> rows[8];
      for (int k = 0; k < 8; ++k) rows[k] = Load<Row<Sum>>(source + k * kStride<Sum>);
      if (IsZero((rows[0] | rows[1]) | (rows[2] | rows[3]) | (rows[4] | rows[5]) |
                 (rows[6] | rows[7]))) {
        continue;
      }
      for (int k = 0; k < 8; ++k) Store(Row<Sum>{}, source + k * kStride<Sum>);
      Transpose(rows);
      for (int k = 0; k < 8; ++k) AddTo(rows[k], to + (x + k) * kStride<Sum> + y);
    }
  }
}

template <>
void MoveTransposed(FaceSum* from, uint32_t groups, FaceSum* to) {
  for (int y = 0; y < kSide; y += 4) {
    if ((groups >> (y / kRowsPerGroup) & 1) == 0) continue;
    for (int x = 0; x < kSide; x += 4) {
      FaceSum* source = from + y * kStride<FaceSum> + x;
#ifdef __AVX2__
      Int32x8 r[4];
      for (int k = 0; k < 4; ++k) r[k] = Load<Int32x8>(source + k * kStride<FaceSum>);
      if (IsZero((r[0] | r[1]) | (r[2] | r[3]))) continue;
      for (int k = 0; k < 4; ++k) Store(Int32x8{}, source + k * kStride<FaceSum>);
      for (int k = 0; k < 4; k += 2) {
        const Int32x8 even = __builtin_shufflevector(r[k], r[k + 1], 0, 1, 8, 9, 4, 5, 12, 13);
        r[k + 1] = __builtin_shufflevector(r[k], r[k + 1], 2, 3, 10, 11, 6, 7, 14, 15);
        r[k] = even;
      }
      for (int k = 0; k < 2; ++k) {
        AddTo(__builtin_shufflevector(r[k], r[k + 2], 0, 1, 2, 3, 8, 9, 10, 11),
              to + (x + k) * kStride<FaceSum> + y);
        AddTo(__builtin_shufflevector(r[k], r[k + 2], 4, 5, 6, 7, 12, 13, 14, 15),
              to + (x + k + 2) * kStride<FaceSum> + y);
      }
#else
      Int32x4 r[4][2];
      for (int k = 0; k < 4; ++k) {
        r[k][0] = Load<Int32x4>(source + k * kStride<FaceSum>);
        r[k][1] = Load<Int32x4>(source + k * kStride<FaceSum> + 2);
      }
      if (IsZero((r[0][0] | r[0][1]) | (r[1][0] | r[1][1]) | (r[2][0] | r[2][1]) |
                 (r[3][0] | r[3][1]))) {
        continue;
      }
      for (int k = 0; k < 4; ++k) Store(Int32x8{}, source + k * kStride<FaceSum>);
      for (int k = 0; k < 4; k += 2) {
        for (int half = 0; half < 2; ++half) {
          FaceSum* const place = to + (x + 2 * half) * kStride<FaceSum> + y + k;
          AddTo(__builtin_shufflevector(r[k][half], r[k + 1][half], 0, 1, 4, 5), place);
          AddTo(__builtin_shufflevector(r[k][half], r[k + 1][half], 2, 3, 6, 7),
                place + kStride<FaceSum>);
        }
      }
#endif
    }
  }
}

Sums Rounded(Sums sums) {
  constexpr int32_t kHalf = 1 << (kSumFractionBits - 1);
  const Sums odd = (sums >> kSumFractionBits) & 1;
  return (sums + (kHalf - 1) + odd) >> kSumFractionBits;
}

bool HasChange(const int32_t* sums) {
  for (int row = 0; row < kSide; ++row) {
    for (int k = 0; k < kSide; k += kLanes) {
      if (!IsZero(Rounded(Load<Sums>(sums + row * kStride<int32_t> + k)))) return true;
    }
  }
  return false;
}

Sums Clamp(Sums v, ControlLimits limits) {
  const Sums least = Sums{} + limits.min;
  const Sums most = Sums{} + limits.max;
  v = v < least ? least : v;
  return v > most ? most : v;
}

// Without a branch for sums that are 0: where they begin and end cannot be foretold.
void Commit(int32_t* sums, ControlLimits limits, ControlLimits scan_limits,
            ControlPoint* control_points) {
  for (int row = 0; row < kSide; ++row) {
    for (int k = 0; k < kSide; k += 2 * kLanes) {
      Sums results[2];
      for (int half = 0; half < 2; ++half) {
        int32_t* const some = sums + row * kStride<int32_t> + k + half * kLanes;
        const Sums change = Rounded(Load<Sums>(some));
        Store(Sums{}, some);
        const Sums old = Widen(Load<ControlPoints>(control_points + half * kLanes));
        Sums result = Clamp(old + Clamp(change, scan_limits), limits);
        result = result == 0 ? Sums{} + 1 : result;  // what was touched stays known
        results[half] = change == 0 ? old : result;
      }
      Store(Narrow(results[0], results[1]), control_points);
      control_points += 2 * kLanes;
    }
  }
}

// (a - b) * c / 2^15, rounded, where the difference saturates.
[[gnu::always_inline]] inline WholeControlPoints Share(WholeControlPoints a, WholeControlPoints b,
                                                       WholeControlPoints c) {
#if defined(__AVX512BW__)
  return reinterpret_cast<WholeControlPoints>(_mm512_mulhrs_epi16(
      _mm512_subs_epi16(reinterpret_cast<__m512i>(a), reinterpret_cast<__m512i>(b)),
      reinterpret_cast<__m512i>(c)));
#elif defined(__AVX2__)
  return reinterpret_cast<WholeControlPoints>(_mm256_mulhrs_epi16(
      _mm256_subs_epi16(reinterpret_cast<__m256i>(a), reinterpret_cast<__m256i>(b)),
      reinterpret_cast<__m256i>(c)));
#elif defined(SPLINEMAP_NEON)
  return reinterpret_cast<WholeControlPoints>(
      vqrdmulhq_s16(vqsubq_s16(reinterpret_cast<int16x8_t>(a), reinterpret_cast<int16x8_t>(b)),
                    reinterpret_cast<int16x8_t>(c)));
#elif defined(__SSE2__)
  const __m128i difference =
      _mm_subs_epi16(reinterpret_cast<__m128i>(a), reinterpret_cast<__m128i>(b));
  const auto share = reinterpret_cast<__m128i>(c);
  const auto high = reinterpret_cast<WholeControlPoints>(_mm_mulhi_epi16(difference, share));
  const auto low = reinterpret_cast<WholeWeights>(_mm_mullo_epi16(difference, share));
  return (high << 1) + reinterpret_cast<WholeControlPoints>((low >> 15) + (low >> 14 & 1));
#else
  using Wide [[gnu::vector_size(8 * kLanes)]] = int32_t;
  const Wide most = Wide{} + 32767;
  Wide difference = __builtin_convertvector(a, Wide) - __builtin_convertvector(b, Wide);
  difference = difference > most ? most : difference;
  difference = difference < ~most ? ~most : difference;
  return __builtin_convertvector((difference * __builtin_convertvector(c, Wide) + (1 << 14)) >> 15,
                                 WholeControlPoints);
#endif
}

// Of as many control points as a register holds.
struct Votes {
  WholeControlPoints distance;
  WholeControlPoints weight;  // up to kMostWeight
};

[[gnu::always_inline]] inline Votes VotesOfFree(const uint16_t* free) {
  const auto weight = Load<WholeWeights>(free);
  const WholeWeights most = WholeWeights{} + SignedDistance::kMostWeight;
  return {WholeControlPoints{} + SignedDistance::kFree,
          reinterpret_cast<WholeControlPoints>(weight < most ? weight : most)};
}

// Moves the sums of faces. Those of free space stay.
[[gnu::always_inline]] inline Votes TakeVotes(const uint16_t* free, FaceSum* faces) {
  constexpr float kRange = SignedDistance::kOccupied - SignedDistance::kFree;
  constexpr int kMost = SignedDistance::kMostWeight;
  Sums distances[2];
  Sums weights[2];
  for (int half = 0; half < 2; ++half) {
    FaceSum* const some = faces + half * kLanes;
    const auto first = Load<Sums>(some);
    const auto second = Load<Sums>(some + kLanes / 2);
    const auto free_weight = Load<HalfWeights>(free + half * kLanes);
    Store(Sums{}, some);
    Store(Sums{}, some + kLanes / 2);
    Sums weight;
    Sums occupied;
    Split(first, second, weight, occupied);
    weight += Widen(free_weight);
    const Shares share = __builtin_convertvector(occupied, Shares) /
                         __builtin_convertvector(weight > 0 ? weight : Sums{} + 1, Shares);
    distances[half] = SignedDistance::kFree + __builtin_convertvector(share * kRange + 0.5F, Sums);
    weights[half] = weight < kMost ? weight : Sums{} + kMost;
  }
  return {Narrow(distances[0], distances[1]), Narrow(weights[0], weights[1])};
}

// Control points moved to their signed distance as far as the weight says; those without weight
// stay.
[[gnu::always_inline]] inline WholeControlPoints Averaged(const Votes& votes,
                                                          WholeControlPoints old,
                                                          ControlLimits limits) {
  constexpr int kMoreBits = 15 - SignedDistance::kForgetBits;
  static_assert(SignedDistance::kMostWeight << kMoreBits < 1 << 15);
  const WholeControlPoints least = WholeControlPoints{} + limits.min;
  const WholeControlPoints most = WholeControlPoints{} + limits.max;
  const WholeControlPoints moved = old + Share(votes.distance, old, votes.weight << kMoreBits);
  WholeControlPoints result = old == 0 ? votes.distance : moved;
  result = result < least ? least : result;
  result = result > most ? most : result;
  result = result == 0 ? WholeControlPoints{} + 1 : result;  // what was touched stays known
  return votes.weight == 0 ? old : result;
}

// Which four of the control points of a register are settled, by what all rows of their cells
// have of kBeyondSettled.
[[gnu::always_inline]] inline TileCells SettledCellsOf(WholeWeights any) {
  using Cells [[gnu::vector_size(4 * kLanes)]] = uint64_t;
  const auto beyond = reinterpret_cast<Cells>(any & kBeyondSettled);
#if defined(__AVX512F__)
  return _mm512_testn_epi64_mask(reinterpret_cast<__m512i>(beyond),
                                 reinterpret_cast<__m512i>(beyond));
#elif defined(__AVX2__)
  const __m256i is_zero =
      _mm256_cmpeq_epi64(reinterpret_cast<__m256i>(beyond), _mm256_setzero_si256());
  return static_cast<TileCells>(_mm256_movemask_pd(_mm256_castsi256_pd(is_zero)));
#else
  return TileCells{beyond[0] == 0} | TileCells{beyond[1] == 0} << 1;
#endif
}

bool CommitDistances(uint16_t* free, uint32_t groups, FaceSum* faces, TileCells face_cells,
                     ControlLimits limits, const ControlPoint* from, ControlPoint* to,
                     TileCells& settled) {
  constexpr int kWhole = 2 * kLanes;
  constexpr int kCell = 4;
  static_assert(kRowsPerGroup == kCell);
  constexpr TileCells kCellsOfWhole = (TileCells{1} << (kWhole / kCell)) - 1;
  WholeControlPoints is_changed{};
  for (int group = 0; group < RowGroups::kPerTile; ++group) {
    if ((groups >> group & 1) == 0) continue;
    const TileCells of_group = face_cells >> (8 * group) & 255;
    for (int k = 0; k < kSide; k += kWhole) {
      // Four rows of a register each.
      const int first_row = kRowsPerGroup * group;
      uint16_t* const some = free + first_row * kStride<uint16_t> + k;
      const int place = first_row * kSide + k;
      const bool has_faces = (of_group >> (k / kCell) & kCellsOfWhole) != 0;
      if (!has_faces && IsZero(Load<Sums>(some) | Load<Sums>(some + kStride<uint16_t>) |
                               Load<Sums>(some + 2 * kStride<uint16_t>) |
                               Load<Sums>(some + 3 * kStride<uint16_t>))) {
        for (int row = 0; row < kRowsPerGroup; ++row) {
          Store(Load<WholeControlPoints>(from + place + row * kSide), to + place + row * kSide);
        }
        continue;
      }
      WholeWeights any{};
      const auto commit_row = [&](int row, const Votes& votes) {
        Store(WholeWeights{}, some + row * kStride<uint16_t>);
        const auto old = Load<WholeControlPoints>(from + place + row * kSide);
        const WholeControlPoints result = Averaged(votes, old, limits);
        is_changed |= result ^ old;
        any |= reinterpret_cast<WholeWeights>(result) + kToSettled;
        Store(result, to + place + row * kSide);
      };
      if (has_faces) {
        FaceSum* const some_faces = faces + first_row * kStride<FaceSum> + k;
        for (int row = 0; row < kRowsPerGroup; ++row) {
          commit_row(
              row, TakeVotes(some + row * kStride<uint16_t>, some_faces + row * kStride<FaceSum>));
        }
      } else {
        for (int row = 0; row < kRowsPerGroup; ++row) {
          commit_row(row, VotesOfFree(some + row * kStride<uint16_t>));
        }
      }
      const int shift = 8 * group + k / kCell;
      settled = (settled & ~(kCellsOfWhole << shift)) | SettledCellsOf(any) << shift;
    }
  }
  return !IsZero(reinterpret_cast<Sums>(is_changed));
}

}  // namespace
}  // namespace splinemap::SPLINEMAP_KERNEL
