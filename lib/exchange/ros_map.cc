#include "lib/exchange/ros_map.h"

#include <png.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <vector>

#include "lib/base/status.h"

namespace splinemap {
namespace {

struct Thresholds {
  double free;
  double occupied;
};

Thresholds ThresholdsOf(RosMode mode) {
  // Between the first two and the last two of the 256 greys: certainty reads as 0 and 100 in every
  // reader (without a threshold map_server reads 99), and all others by proportion.
  if (mode == RosMode::kScale) return {0.002, 0.998};
  // Those of map_saver: pixel 205 is just above the lower one.
  return {0.196, 0.65};
}

uint8_t TrinaryPixel(const SurfaceSample& sample) {
  constexpr uint8_t kOccupied = 0;
  constexpr uint8_t kFree = 254;
  constexpr uint8_t kUnknown = 205;
  const Thresholds thresholds = ThresholdsOf(RosMode::kTrinary);
  if (!sample.known) return kUnknown;
  const double p = Probability(sample.log_odds);
  return p > thresholds.occupied ? kOccupied : p < thresholds.free ? kFree : kUnknown;
}

uint8_t RawPixel(const SurfaceSample& sample) {
  constexpr uint8_t kUnknown = 255;
  if (!sample.known) return kUnknown;
  return static_cast<uint8_t>(std::lround(100 * Probability(sample.log_odds)));
}

absl::Status WritePgm(const MapView& map, const PixelGrid& grid,
                      uint8_t (*pixel_of)(const SurfaceSample&), NewFile& file) {
  SPLINEMAP_RETURN_IF_ERROR(file.Write(fmt::format("P5\n{} {}\n255\n", grid.width, grid.height)));
  std::string pixels(grid.width, '\0');
  for (int row = 0; row < grid.height; ++row) {
    const double y_m = grid.CentreY(row);
    for (int column = 0; column < grid.width; ++column) {
      pixels[column] = static_cast<char>(pixel_of(map.Evaluate(grid.CentreX(column), y_m)));
    }
    SPLINEMAP_RETURN_IF_ERROR(file.Write(pixels));
  }
  return absl::OkStatus();
}

struct Rgba {
  uint8_t red, green, blue, alpha;
};

Rgba ScalePixel(const SurfaceSample& sample) {
  // map_server asks for transparency only between the thresholds.
  if (!sample.known) return {128, 128, 128, 0};
  const auto grey = static_cast<uint8_t>(255 - std::lround(255 * Probability(sample.log_odds)));
  return {grey, grey, grey, 255};
}

// In four channels, though two would do: readers of grey with transparency differ.
absl::Status WriteScalePng(const MapView& map, const PixelGrid& grid, NewFile& file) {
  std::vector<Rgba> pixels;
  pixels.reserve(size_t{1} * grid.width * grid.height);
  for (int row = 0; row < grid.height; ++row) {
    const double y_m = grid.CentreY(row);
    for (int column = 0; column < grid.width; ++column) {
      pixels.push_back(ScalePixel(map.Evaluate(grid.CentreX(column), y_m)));
    }
  }
  png_image image{};
  image.version = PNG_IMAGE_VERSION;
  image.width = static_cast<png_uint_32>(grid.width);
  image.height = static_cast<png_uint_32>(grid.height);
  image.format = PNG_FORMAT_RGBA;
  if (png_image_write_to_stdio(&image, file.stream(), 0, pixels.data(), 0, nullptr) == 0) {
    return Unavailable("cannot write {}: {}", file.path(), image.message);
  }
  return absl::OkStatus();
}

// A plain scalar where that is safe, as other writers do, else in double quotes.
absl::StatusOr<std::string> YamlString(const std::string& text) {
  const auto is_plain = [](char c) {
    return (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || (c >= '0' && c <= '9') || c == '_' ||
           c == '.' || c == '-';
  };
  if (std::all_of(text.begin(), text.end(), is_plain) && text[0] != '-') return text;
  std::string quoted = "\"";
  for (const char c : text) {
    if (static_cast<unsigned char>(c) < ' ' || c == '\x7f') {
      return InvalidArgument("a file name with control characters cannot stand in a .yaml file");
    }
    if (c == '"' || c == '\\') quoted += '\\';
    quoted += c;
  }
  return quoted + '"';
}

}  // namespace

const char* NameOf(RosMode mode) {
  return mode == RosMode::kTrinary ? "trinary" : mode == RosMode::kScale ? "scale" : "raw";
}

std::string RosImageExtension(RosMode mode) { return mode == RosMode::kScale ? ".png" : ".pgm"; }

absl::Status WriteRosImage(const MapView& map, const PixelGrid& grid, RosMode mode, NewFile& file) {
  if (mode == RosMode::kScale) return WriteScalePng(map, grid, file);
  return WritePgm(map, grid, mode == RosMode::kTrinary ? TrinaryPixel : RawPixel, file);
}

absl::StatusOr<std::string> RosYaml(const PixelGrid& grid, RosMode mode, const std::string& image) {
  SPLINEMAP_ASSIGN_OR_RETURN(const std::string image_name, YamlString(image));
  const Thresholds thresholds = ThresholdsOf(mode);
  // {:#} keeps the decimal point, without which YAML 1.1 takes 1e-05 for text.
  return fmt::format(
      "image: {}\nmode: {}\nresolution: {:#}\norigin: [{:#}, {:#}, 0.0]\nnegate: 0\n"
      "occupied_thresh: {}\nfree_thresh: {}\n",
      image_name, NameOf(mode), grid.pixel_m, grid.left_m, grid.bottom_m(), thresholds.occupied,
      thresholds.free);
}

}  // namespace splinemap
