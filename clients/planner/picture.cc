#include "clients/planner/picture.h"

#include <png.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <utility>
#include <vector>

#include "lib/base/file.h"
#include "lib/base/status.h"
#include "lib/render/raster.h"

namespace splinemap {
namespace {

using Colour = std::array<double, 3>;
using Eigen::Vector2d;

constexpr Colour kUnknown = {176, 190, 205};
constexpr Colour kBefore = {235, 120, 10};
constexpr Colour kNow = {20, 100, 230};
constexpr Colour kStart = {20, 150, 60};
constexpr Colour kGoal = {215, 30, 50};
constexpr Colour kWhite = {255, 255, 255};

double DistanceToLeg(const Vector2d& point, const Vector2d& from, const Vector2d& to) {
  const Vector2d leg = to - from;
  const double share = leg.squaredNorm() > 0 ? (point - from).dot(leg) / leg.squaredNorm() : 0;
  return (point - from - std::clamp(share, 0.0, 1.0) * leg).norm();
}

double DistanceToPath(const Vector2d& point, const Path& path) {
  double distance = std::numeric_limits<double>::infinity();
  for (size_t k = 0; k < path.size(); ++k) {
    distance = std::min(distance, DistanceToLeg(point, path[k], path[k == 0 ? 0 : k - 1]));
  }
  return distance;
}

class Image {
 public:
  explicit Image(const Raster& map) : grid_(map.grid) {
    for (const uint8_t pixel : map.pixels) {
      const auto grey = static_cast<double>(pixel);
      pixels_.push_back(pixel == Raster::kUnknown ? kUnknown : Colour{grey, grey, grey});
    }
  }

  // A line of round ends, or a disc of one vertex, with soft edges.
  void Stroke(const Path& path, double radius_m, const Colour& colour, double opacity = 1) {
    Eigen::AlignedBox2d box;
    for (const Vector2d& vertex_m : path) box.extend(vertex_m);
    for (int row = 0; row < grid_.height; ++row) {
      for (int column = 0; column < grid_.width; ++column) {
        const Vector2d centre_m(grid_.CentreX(column), grid_.CentreY(row));
        if (box.exteriorDistance(centre_m) > radius_m + grid_.pixel_m) continue;
        const double inside_px = (radius_m - DistanceToPath(centre_m, path)) / grid_.pixel_m + 0.5;
        const double share = opacity * std::clamp(inside_px, 0.0, 1.0);
        Colour& pixel = pixels_[size_t{1} * row * grid_.width + column];
        for (size_t k = 0; k < pixel.size(); ++k) pixel[k] += share * (colour[k] - pixel[k]);
      }
    }
  }

  absl::Status Write(NewFile& file) const {
    std::vector<png_byte> bytes;
    for (const Colour& pixel : pixels_) {
      for (const double value : pixel) bytes.push_back(static_cast<png_byte>(std::lround(value)));
    }
    png_image image{};
    image.version = PNG_IMAGE_VERSION;
    image.width = static_cast<png_uint_32>(grid_.width);
    image.height = static_cast<png_uint_32>(grid_.height);
    image.format = PNG_FORMAT_RGB;
    if (png_image_write_to_stdio(&image, file.stream(), 0, bytes.data(), 0, nullptr) == 0) {
      return Unavailable("cannot write {}: {}", file.path(), image.message);
    }
    return absl::OkStatus();
  }

 private:
  PixelGrid grid_;
  std::vector<Colour> pixels_;
};

}  // namespace

absl::Status WritePicture(const MapView& map, const PathPicture& picture, const std::string& file) {
  SPLINEMAP_ASSIGN_OR_RETURN(const PixelGrid grid,
                             FittingGrid(map, FittingPixelsPerKnot(map, 1000)));
  const double line_m = 1.5 * grid.pixel_m;
  Image image(RenderMap(map, grid));
  image.Stroke(picture.now, picture.radius_m, kNow, 0.2);
  image.Stroke(picture.before, line_m, kBefore);
  image.Stroke(picture.now, line_m, kNow);
  for (const auto& [point_m, colour] :
       {std::pair(picture.start_m, kStart), std::pair(picture.goal_m, kGoal)}) {
    image.Stroke({point_m}, 6 * line_m, kWhite);
    image.Stroke({point_m}, 5 * line_m, colour);
  }
  SPLINEMAP_ASSIGN_OR_RETURN(NewFile out, NewFile::Create(file));
  SPLINEMAP_RETURN_IF_ERROR(image.Write(out));
  return out.Commit();
}

}  // namespace splinemap
