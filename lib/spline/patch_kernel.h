#pragma once

#include <cstdint>

#include "lib/base/lanes.h"
#include "splinemap/surface.h"

// EvaluatePatch() for functions that are compiled for several kinds of instructions, which have to
// inline it: for one point, and for four of them. Without fused multiplications, and with sums in
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

// One number of the basis for four points.
__attribute__((always_inline)) inline Doubles4 BasisOf4(int k, Doubles4 t) {
  return ((kBasisPieces[3][k] * t + kBasisPieces[2][k]) * t + kBasisPieces[1][k]) * t +
         kBasisPieces[0][k];
}

__attribute__((always_inline)) inline Doubles4 BasisDerivativeOf4(int k, Doubles4 t) {
  return (3 * kBasisPieces[3][k] * t + 2 * kBasisPieces[2][k]) * t + kBasisPieces[1][k];
}

__attribute__((always_inline)) inline Doubles4 SumOf4(const Doubles4 (&a)[4],
                                                      const Doubles4 (&b)[4]) {
  return (a[0] * b[0] + a[1] * b[1]) + (a[2] * b[2] + a[3] * b[3]);
}

// Number k of the four control points in each word, of which the sign bits are flipped. There is no
// vector conversion of 64-bit integers before AVX-512; but 2^52 + n, for small n >= 0, is a double
// whose low bits are n.
__attribute__((always_inline)) inline Doubles4 ControlPointOf4(Words4 row, int k) {
  constexpr uint64_t kTwo52 = 0x4330000000000000;
  row >>= 16 * k;
#ifdef __AVX2__
  const __m256i bits =
      _mm256_blend_epi16(_mm256_set1_epi64x(kTwo52), reinterpret_cast<__m256i>(row), 0x11);
#else
  const Words4 bits = (row & 0xffff) | kTwo52;
#endif
  return reinterpret_cast<Doubles4>(bits) - (0x1p52 + 0x1p15);
}

struct Samples4 {
  Doubles4 log_odds;
  Doubles4 gradient_x_per_m;
  Doubles4 gradient_y_per_m;
};

// Four points. rows[r]: of each point the control points of row r, the first in the low 16 bits.
__attribute__((always_inline)) inline Samples4 EvaluateRowsOf4(const Words4 (&rows)[4],
                                                               Doubles4 t_x, Doubles4 t_y,
                                                               double scale, double knots_per_m) {
  Doubles4 bx[4];
  Doubles4 dbx[4];
  for (int k = 0; k < 4; ++k) {
    bx[k] = BasisOf4(k, t_x);
    dbx[k] = BasisDerivativeOf4(k, t_x);
  }
  Doubles4 sums[4];
  Doubles4 derivative_sums[4];
  for (int r = 0; r < 4; ++r) {
    const Words4 row = rows[r] ^ 0x8000800080008000;
    Doubles4 c[4];
    for (int k = 0; k < 4; ++k) c[k] = ControlPointOf4(row, k);
    sums[r] = SumOf4(c, bx);
    derivative_sums[r] = SumOf4(c, dbx);
  }
  Doubles4 by[4];
  Doubles4 dby[4];
  for (int k = 0; k < 4; ++k) {
    by[k] = BasisOf4(k, t_y);
    dby[k] = BasisDerivativeOf4(k, t_y);
  }
  return {scale * SumOf4(by, sums), scale * knots_per_m * SumOf4(by, derivative_sums),
          scale * knots_per_m * SumOf4(dby, sums)};
}

}  // namespace splinemap
