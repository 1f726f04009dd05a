#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "lib/base/file.h"
#include "lib/render/pixel_grid.h"
#include "splinemap/map_view.h"
#include "splinemap/pose2.h"

namespace splinemap {

// A picture of two maps in the frame of the first, a colour for each pixel of the grid.
struct Overlay {
  using Colour = std::array<uint8_t, 3>;  // red, green, blue

  static constexpr Colour kUnknown = {176, 190, 205};
  static constexpr Colour kFree = {255, 255, 255};
  static constexpr Colour kFreeInA = {214, 228, 255};
  static constexpr Colour kFreeInB = {255, 232, 204};
  static constexpr Colour kObstacle = {0, 0, 0};  // of both
  static constexpr Colour kObstacleInA = {20, 70, 210};
  static constexpr Colour kObstacleInB = {225, 95, 0};

  PixelGrid grid;
  std::vector<Colour> pixels;  // grid.width * grid.height
};

// Around both maps, `side` pixels along the longer side or fewer. FailedPrecondition where one has
// no control point that was touched.
absl::StatusOr<PixelGrid> GridAroundBoth(const MapView& a, const MapView& b, const Pose2& a_T_b,
                                         int side);

// What is an obstacle of one map is drawn as that, whatever the other saw there.
Overlay RenderBoth(const MapView& a, const MapView& b, const Pose2& a_T_b, const PixelGrid& grid);

absl::Status WritePng(const Overlay& overlay, NewFile& file);

}  // namespace splinemap
