#pragma once

#include <cstdint>

#include "lib/base/lanes.h"
#include "splinemap/surface.h"

// EvaluatePatch() for functions that are compiled for several kinds of instructions, which have to
// inline it: for one point, and for several. Without fused multiplications, and with sums in
// the same order, all give the same bytes.
//
// s = by^T C bx, equation (4) with rows for y; derivatives are by phase until the end.

namespace splinemap {

// The pieces of the cubic basis spline as polynomials in t, by power; see Basis().
inline constexpr double kBasisPieces[4][4] = {{1.0 / 6, 4.0 / 6, 1.0 / 6, 0},
                                              {-0.5, 0, 0.5, 0},
                                              {0.5, -1, 0.5, 0},
                                              {-1.0 / 6, 0.5, -0.5, 1.0 / 6}};

__attribute__((always_inline)) inline Doubles4 BasisPieces(int power) {
  const double(&k)[4] = kBasisPieces[power];
  return Doubles4{k[0], k[1], k[2], k[3]};
}

__attribute__((always_inline)) inline Doubles4 BasisRow(double t) {
  return ((BasisPieces(3) * t + BasisPieces(2)) * t + BasisPieces(1)) * t + BasisPieces(0);
}

__attribute__((always_inline)) inline Doubles4 BasisDerivativeRow(double t) {
  return (3 * BasisPieces(3) * t + 2 * BasisPieces(2)) * t + BasisPieces(1);
}

// The sums of each of four vectors.
__attribute__((always_inline)) inline Doubles4 Sums(Doubles4 p0, Doubles4 p1, Doubles4 p2,
                                                    Doubles4 p3) {
  const Doubles4 s01 =
      __builtin_shufflevector(p0, p1, 0, 4, 2, 6) + __builtin_shufflevector(p0, p1, 1, 5, 3, 7);
  const Doubles4 s23 =
      __builtin_shufflevector(p2, p3, 0, 4, 2, 6) + __builtin_shufflevector(p2, p3, 1, 5, 3, 7);
  return __builtin_shufflevector(s01, s23, 0, 1, 4, 5) +
         __builtin_shufflevector(s01, s23, 2, 3, 6, 7);
}

// One point: (ds/dx, ds/dy, s, 0), as SurfaceSample has them. `rows`: its control points, of which
// `scale` makes log-odds.
__attribute__((always_inline)) inline Doubles4 EvaluateRows(const Doubles4 (&rows)[4], double t_x,
                                                            double t_y, double scale,
                                                            double knots_per_m) {
  const Doubles4 bx = BasisRow(t_x);
  const Doubles4 dbx = BasisDerivativeRow(t_x);
  const Doubles4 sums = Sums(rows[0] * bx, rows[1] * bx, rows[2] * bx, rows[3] * bx);
  const Doubles4 derivative_sums = Sums(rows[0] * dbx, rows[1] * dbx, rows[2] * dbx, rows[3] * dbx);
  const Doubles4 by = BasisRow(t_y);
  const double scale_per_m = scale * knots_per_m;
  return Doubles4{scale_per_m, scale_per_m, scale, 0} *
         Sums(by * derivative_sums, BasisDerivativeRow(t_y) * sums, by * sums, Doubles4{});
}

// a + b, but for the sign of a zero, which is lost where this is called.
template <typename Doubles>
__attribute__((always_inline)) inline Doubles Plus(Doubles a, double b) {
  return b == 0 ? a : a + b;
}

// One number of the basis for each of several points, four or eight.
template <typename Doubles>
__attribute__((always_inline)) inline Doubles BasisOfEach(int k, Doubles t) {
  const Doubles square = Plus(kBasisPieces[3][k] * t, kBasisPieces[2][k]) * t;
  return Plus(Plus(square, kBasisPieces[1][k]) * t, kBasisPieces[0][k]);
}

template <typename Doubles>
__attribute__((always_inline)) inline Doubles BasisDerivativeOfEach(int k, Doubles t) {
  return Plus(3 * kBasisPieces[3][k] * t, 2 * kBasisPieces[2][k]) * t + kBasisPieces[1][k];
}

template <typename Doubles>
__attribute__((always_inline)) inline Doubles SumOfEach(const Doubles (&a)[4],
                                                        const Doubles (&b)[4]) {
  return (a[0] * b[0] + a[1] * b[1]) + (a[2] * b[2] + a[3] * b[3]);
}

// Number k of the four control points in each word, of which the sign bits are flipped. There is no
// vector conversion of 64-bit integers before AVX-512; but 2^52 + n, for small n >= 0, is a double
// whose low bits are n.
template <typename Doubles, typename Words>
__attribute__((always_inline)) inline Doubles ControlPointOfEach(Words row, int k) {
  constexpr uint64_t kTwo52 = 0x4330000000000000;
  row >>= 16 * k;
  Words bits;
#ifdef __AVX2__
  if constexpr (sizeof(Words) == sizeof(__m256i)) {
    bits = reinterpret_cast<Words>(
        _mm256_blend_epi16(_mm256_set1_epi64x(kTwo52), reinterpret_cast<__m256i>(row), 0x11));
  } else
#endif
    bits = (row & 0xffff) | kTwo52;
  return reinterpret_cast<Doubles>(bits) - (0x1p52 + 0x1p15);
}

template <typename Doubles>
struct SampleOfEach {
  Doubles log_odds;
  Doubles gradient_x_per_m;
  Doubles gradient_y_per_m;
};

// Several points. rows[r]: of each point the control points of row r, the first in the low 16 bits.
template <typename Doubles, typename Words>
__attribute__((always_inline)) inline SampleOfEach<Doubles> EvaluateRowsOfEach(
    const Words (&rows)[4], Doubles t_x, Doubles t_y, double scale, double knots_per_m) {
  Doubles bx[4];
  Doubles dbx[4];
  for (int k = 0; k < 4; ++k) {
    bx[k] = BasisOfEach(k, t_x);
    dbx[k] = BasisDerivativeOfEach(k, t_x);
  }
  Doubles sums[4];
  Doubles derivative_sums[4];
  for (int r = 0; r < 4; ++r) {
    const Words row = rows[r] ^ 0x8000800080008000;
    Doubles c[4];
    for (int k = 0; k < 4; ++k) c[k] = ControlPointOfEach<Doubles>(row, k);
    sums[r] = SumOfEach(c, bx);
    derivative_sums[r] = SumOfEach(c, dbx);
  }
  Doubles by[4];
  Doubles dby[4];
  for (int k = 0; k < 4; ++k) {
    by[k] = BasisOfEach(k, t_y);
    dby[k] = BasisDerivativeOfEach(k, t_y);
  }
  return {scale * SumOfEach(by, sums), scale * knots_per_m * SumOfEach(by, derivative_sums),
          scale * knots_per_m * SumOfEach(dby, sums)};
}

}  // namespace splinemap
