#pragma once

#include <array>
#include <cmath>
#include <compare>
#include <cstdint>
#include <optional>

namespace splinemap {

// A coefficient of the surface in fixed point. 0 means that no measurement ever touched it.
using ControlPoint = int16_t;
inline constexpr int kUnitsPerLogOdds = 256;
// What beams make of control points that they pass, away from what they hit.
inline constexpr ControlPoint kFreeControlPoint = -8 * kUnitsPerLogOdds;

// Control points stay in [min, max], equation (36).
struct ControlLimits {
  ControlPoint min = -100 * kUnitsPerLogOdds;
  ControlPoint max = 100 * kUnitsPerLogOdds;
  auto operator<=>(const ControlLimits&) const = default;
};

// `sum` within `limits`, and +1 instead of 0: what was touched stays known.
inline ControlPoint ClampTouched(int32_t sum, ControlLimits limits) {
  const int32_t clamped = sum < limits.min ? limits.min : sum > limits.max ? limits.max : sum;
  return static_cast<ControlPoint>(clamped == 0 ? 1 : clamped);
}

// Control points of |index| up to this exist; 0.05 m apart they span 13,000 km each way.
inline constexpr int32_t kMaxKnotIndex = 1 << 28;

// A coordinate in knot intervals: coordinate = (index + t) * knot_interval, t in [0, 1).
struct KnotPosition {
  int32_t index = 0;
  double t = 0;
};

// Empty where the coordinate is not finite or out of the range of kMaxKnotIndex.
inline std::optional<KnotPosition> LocateKnot(double coordinate_m, double knot_interval_m) {
  const double position = coordinate_m / knot_interval_m;
  if (!(std::abs(position) < kMaxKnotIndex)) return std::nullopt;
  const auto towards_zero = static_cast<int32_t>(position);
  const int32_t index = towards_zero - (position < towards_zero ? 1 : 0);
  return KnotPosition{index, position - index};
}

// Names the square of control points [32 tx, 32 tx + 32) x [32 ty, 32 ty + 32), for ever the same
// square of the layer's frame.
struct TileKey {
  int32_t tx = 0;
  int32_t ty = 0;

  auto operator<=>(const TileKey&) const = default;
  template <typename H>
  friend H AbslHashValue(H h, const TileKey& key) {
    return H::combine(std::move(h), key.tx, key.ty);
  }
};

// True for the keys of control points within kMaxKnotIndex, the only ones that a TileTree takes.
constexpr bool IsInRange(TileKey key) {
  constexpr int32_t kMax = kMaxKnotIndex >> 5;
  return key.tx >= -kMax && key.tx <= kMax && key.ty >= -kMax && key.ty <= kMax;
}

// 32 x 32 control points, row-major: x runs fastest. An absent tile equals one of zeros.
struct alignas(64) Tile {
  static constexpr int kSide = 32;
  static constexpr int kSize = kSide * kSide;

  std::array<ControlPoint, kSize> control_points{};

  bool operator==(const Tile&) const = default;
};

// Control point (i, j) belongs to tile TileOf(i, j) at position IndexInTile(i, j).
constexpr TileKey TileOf(int32_t i, int32_t j) { return {i >> 5, j >> 5}; }
constexpr int IndexInTile(int32_t i, int32_t j) { return ((j & 31) << 5) | (i & 31); }

// The control points of a tile that a measurement touched.
struct TouchedPoints {
  int16_t points = 0;
  int8_t i0 = 0;  // the box around them, its last row and column included; of none: zeros
  int8_t j0 = 0;
  int8_t i1 = 0;
  int8_t j1 = 0;
  bool operator==(const TouchedPoints&) const = default;

  // In 31 bits.
  uint32_t Packed() const {
    return static_cast<uint32_t>(points) << 20 | static_cast<uint32_t>(i0) << 15 |
           static_cast<uint32_t>(j0) << 10 | static_cast<uint32_t>(i1) << 5 |
           static_cast<uint32_t>(j1);
  }
  static TouchedPoints Unpacked(uint32_t packed) {
    const auto coordinate = [packed](int bit) { return static_cast<int8_t>(packed >> bit & 31); };
    return {static_cast<int16_t>(packed >> 20 & 2047), coordinate(15), coordinate(10),
            coordinate(5), coordinate(0)};
  }
};
TouchedPoints TouchedPointsOf(const Tile& tile);

inline int CountTouched(const Tile& tile) { return TouchedPointsOf(tile).points; }

// Cells of 4 x 4 control points of a tile, a bit each, row-major.
using TileCells = uint64_t;
// Those in which each control point is so near to kFreeControlPoint that no beam that passes
// changes it any more.
TileCells SettledCellsOf(const Tile& tile);
// A control point is settled if the sum with the first has nothing in common with the second: a
// quarter of the way, rounded, from kFreeControlPoint - 1 .. kFreeControlPoint + 2 is 0.
inline constexpr uint16_t kToSettled = 1 - kFreeControlPoint;
inline constexpr uint16_t kBeyondSettled = 0xfffc;

}  // namespace splinemap
