#include "lib/exchange/ros_grid.h"

#include <gtest/gtest.h>
#include <png.h>

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <functional>
#include <vector>

#include "lib/base/file.h"
#include "lib/base/status.h"
#include "lib/exchange/ros_map.h"
#include "lib/map/summed_layers.h"
#include "splinemap/map_view.h"
#include "tests/support/temporary_directory.h"

namespace splinemap::ros_grid_test {

// A folder with lab.yaml and its picture.
class RosFiles {
 public:
  // `field` replaces the line of its name, or stands beside the others.
  std::string Yaml(const std::string& field = "") const {
    const std::string name = field.substr(0, field.find(':'));
    std::string text;
    for (const std::string line : {"image: lab.pgm", "resolution: 0.05", "origin: [-1.0, 2.0, 0.0]",
                                   "negate: 0", "occupied_thresh: 0.65", "free_thresh: 0.196"}) {
      if (!line.starts_with(name + ":")) text += line + "\n";
    }
    EXPECT_TRUE(WriteFile(directory_.File("lab.yaml"), text + field + "\n").ok());
    return directory_.File("lab.yaml");
  }
  std::string Picture(const std::string& content, const std::string& name = "lab.pgm") const {
    EXPECT_TRUE(WriteFile(directory_.File(name), content).ok());
    return directory_.File(name);
  }
  // Of pixels of four bytes.
  void Png(int width, int height, const std::vector<uint8_t>& rgba) const {
    png_image image{};
    image.version = PNG_IMAGE_VERSION;
    image.width = static_cast<png_uint_32>(width);
    image.height = static_cast<png_uint_32>(height);
    image.format = PNG_FORMAT_RGBA;
    const std::string path = directory_.File("lab.png");
    EXPECT_NE(png_image_write_to_file(&image, path.c_str(), 0, rgba.data(), 0, nullptr), 0);
  }

 private:
  TemporaryDirectory directory_;
};

constexpr uint8_t kUnknown = RosGrid::kUnknown;
using Cells = std::vector<uint8_t>;

TEST(RosGridTest, EachModeReadsPixelsAsNav2Does) {
  const RosFiles files;
  files.Picture(
      std::string("P5\n# by hand\n5 2\n255\n\x00\xfe\xcd\x64\xff\x80\x00\x00\x00\x5a", 32));
  // The lower row comes first.
  EXPECT_EQ(ReadRosGrid(files.Yaml())->per_cent,
            (Cells{kUnknown, 100, 100, 100, kUnknown, 100, 0, kUnknown, kUnknown, 0}));
  EXPECT_EQ(ReadRosGrid(files.Yaml("mode: scale"))->per_cent,
            (Cells{67, 100, 100, 100, 99, 100, 0, 0, 91, 0}));
  EXPECT_EQ(ReadRosGrid(files.Yaml("mode: raw"))->per_cent,
            (Cells{kUnknown, 0, 0, 0, 90, 0, kUnknown, kUnknown, 100, kUnknown}));
  EXPECT_EQ(ReadRosGrid(files.Yaml("negate: true"))->per_cent,
            (Cells{kUnknown, 0, 0, 0, kUnknown, 0, 100, 100, kUnknown, 100}));
}

TEST(RosGridTest, PixelsOfAPngThatAreNotOpaqueAreUnknown) {
  const RosFiles files;
  files.Png(2, 2, {0, 0, 0, 255, 254, 254, 254, 255, 0, 0, 0, 0, 205, 205, 205, 255});
  for (const std::string mode : {"trinary", "scale"}) {
    const auto grid = ReadRosGrid(files.Yaml("image: lab.png\nmode: " + mode));
    ASSERT_TRUE(grid.ok()) << grid.status();
    const uint8_t grey = mode == "trinary" ? kUnknown : 0;  // 0.196 is just above free_thresh
    EXPECT_EQ(grid->per_cent, (Cells{kUnknown, grey, 100, 0}));
  }
}

TEST(RosGridTest, WhatIsWrongIsSaid) {
  const RosFiles files;
  const auto expect_error = [&](const std::string& field, const std::string& text) {
    const auto grid = ReadRosGrid(files.Yaml(field));
    ASSERT_FALSE(grid.ok()) << field;
    EXPECT_NE(grid.status().ToString().find(text), std::string::npos) << grid.status();
  };
  expect_error("", "there is no file");
  files.Picture("P5 2 2 255 123");
  expect_error("", "is cut off: it has not 2 x 2 pixels");
  files.Picture("P5 2 2 65535 12345678");
  expect_error("", "8 bits a pixel");
  files.Picture("P5 100000 100000 255 ");
  expect_error("", "is cut off");
  std::filesystem::resize_file(files.Picture("P5 20000 20000 255 "), 400'000'100);
  expect_error("", "20000 x 20000 cells; 100000000 are the most");
  files.Picture("P5 0 7 255 ");
  expect_error("", "has no pixels");
  files.Picture("P2 1 1 255 3");
  expect_error("", "neither a PNG nor a binary PGM");
  files.Picture("\x89PNG\r\n\x1a\n and no more", "cut.png");
  expect_error("image: cut.png", "cannot be read");
  expect_error("image: .", "is no file");
  expect_error("image:\n  - a", "the field image is not a file name");
  expect_error("mode: best", "it is trinary, scale or raw");
  expect_error("negate: 2", "the field negate is not 0 or 1");
  expect_error("resolution: .nan", "it has to be positive");
  expect_error("resolution: -0.05", "it has to be positive");
  expect_error("resolution: fine", "the field resolution is not a number");
  expect_error("origin: [0, 0]", "the origin is not [x, y, yaw]");
  expect_error("origin: [0, .inf, 0]", "the origin is not [x, y, yaw]");
  expect_error("free_thresh: 0.7", "they have to rise from 0 to 1");
  expect_error("occupied_thresh:", "the field occupied_thresh is not a number");
  expect_error("x: [[[", "is no YAML");
  const auto error_of = [&](const std::string& yaml) {
    return ErrorText(ReadRosGrid(files.Picture(yaml, "other.yaml")).status());
  };
  EXPECT_NE(error_of("image: lab.pgm\n").find("the field resolution is missing"),
            std::string::npos);
  EXPECT_NE(error_of("lab.pgm").find("it has no fields"), std::string::npos);
  EXPECT_NE(error_of(std::string(100'000, ' ')).find("too large"), std::string::npos);
}

constexpr double kOccupied = 0.62;  // log-odds of 0.65
constexpr double kFree = -1.41;     // of 0.196

// A room of 41 x 31 cells with walls of one cell, one of them aslant, beyond which is unknown.
RosGrid Room(double cell_m, Pose2 map_T_grid) {
  RosGrid grid{"", 45, 35, cell_m, map_T_grid, Cells(45 * 35, kUnknown)};
  for (int y = 2; y <= 32; ++y) {
    for (int x = 2; x <= 42; ++x) {
      const bool is_wall = x == 2 || x == 42 || y == 2 || y == 32 || (x == y && y < 15);
      grid.per_cent[y * grid.width + x] = is_wall ? 100 : 0;
    }
  }
  return grid;
}

std::shared_ptr<const MapView> ViewOf(const RosGrid& grid, double knot_m) {
  const MapOptions options{knot_m, {}};
  const auto tiles = TilesOf(grid, {}, options);
  EXPECT_TRUE(tiles.ok()) << tiles.status();
  return splinemap::ViewOf({.options = options, .layers = {{{"lab", 1}, {1, 1}, 1, *tiles}}});
}

// Calls check(cell, x, y, surface) with the surface at the centre of each cell.
void ForEachCell(const RosGrid& grid, const MapView& map,
                 const std::function<void(uint8_t, int, int, const SurfaceSample&)>& check) {
  for (int y = 0; y < grid.height; ++y) {
    for (int x = 0; x < grid.width; ++x) {
      const Eigen::Vector2d centre =
          grid.map_T_grid * (grid.cell_m * Eigen::Vector2d(x + 0.5, y + 0.5));
      check(grid.per_cent[y * grid.width + x], x, y, map.Evaluate(centre.x(), centre.y()));
    }
  }
}

// How ever grid and knots lie: centres of cells on knots, edges on knots, anything else, turned,
// cells smaller and larger than the knot interval.
TEST(RosGridTest, ThinWallsStayFreeSpaceStaysAndUnknownStays) {
  constexpr double kKnot_m = 0.05;
  for (const double cell_m : {0.02, 0.025, 0.05, 0.07, 0.1}) {
    for (const Pose2& pose : {Pose2{{0, 0}, 0}, Pose2{{-1.025, 0.975}, 0}, Pose2{{0.013, -7.03}, 0},
                              Pose2{{-3, 2}, 0.3}, Pose2{{5, 5}, -2.2}}) {
      const RosGrid grid = Room(cell_m, pose);
      const auto map = ViewOf(grid, kKnot_m);
      int walls = 0, free = 0, unknown = 0;
      ForEachCell(grid, *map, [&](uint8_t cell, int x, int y, const SurfaceSample& sample) {
        const auto where = [&] {
          return fmt::format("{} m, {} rad, cell {}, {}", cell_m, pose.yaw_rad, x, y);
        };
        // The smoothing reaches over two knot intervals.
        const double reach = 2 * kKnot_m / cell_m + 1;
        const bool is_clear = std::min({x - 2, 42 - x, y - 2, 32 - y}) > reach &&
                              (std::abs(x - y) > 2 * reach || y > 15 + reach);
        // Cells that touch at their corners, and those smaller than a knot interval, at least
        // block.
        const double wall = x == y || cell_m < kKnot_m ? 0 : kOccupied;
        const bool is_end = x == 14 && y == 14;
        EXPECT_TRUE(cell != 100 || is_end || sample.log_odds > wall) << where() << sample.log_odds;
        EXPECT_TRUE(cell != 0 || !is_clear || sample.log_odds < kFree) << where();
        const bool is_far = std::min(x, y) < 1 || x > 43 || y > 33;
        EXPECT_FALSE(is_far && cell_m >= kKnot_m && sample.known) << where();
        walls += cell == 100;
        free += cell == 0 && is_clear;
        unknown += cell == kUnknown;
      });
      EXPECT_GT(walls, 100);
      EXPECT_GT(free, cell_m < 0.05 ? 50 : 300);
      EXPECT_GT(unknown, 200);
    }
  }
}

// At the knot interval, with the centres of cells on knots, as `splinemap export` writes them.
TEST(RosGridTest, CellsOnKnotsAreTheControlPoints) {
  const RosGrid grid = Room(0.05, {{-0.025, -0.025}, 0});
  const auto tiles = TilesOf(grid, {2, -1}, {0.05, {}});
  ASSERT_TRUE(tiles.ok());
  for (int y = 0; y < grid.height; ++y) {
    for (int x = 0; x < grid.width; ++x) {
      const uint8_t cell = grid.per_cent[y * grid.width + x];
      const auto tile = FindTile(*tiles, TileOf(x, y));
      ASSERT_NE(tile, nullptr);
      EXPECT_EQ(tile->control_points[IndexInTile(x, y)], cell == kUnknown ? 0
                                                         : cell == 100    ? 512
                                                                          : -256);
    }
  }
}

TEST(RosGridTest, CellsThatAreNotCertainWeighAsTheirProbabilitySays) {
  const RosGrid grid{"", 5, 1, 1, {{-0.5, -0.5}, 0}, {0, 20, 50, 70, 100}};
  const auto tiles = TilesOf(grid, {}, {1, {}});
  ASSERT_TRUE(tiles.ok());
  const auto tile = FindTile(*tiles, {0, 0});
  ASSERT_NE(tile, nullptr);
  const auto& control_points = tile->control_points;
  EXPECT_EQ(control_points[0], -2.5 * kUnitsPerLogOdds);
  EXPECT_NEAR(control_points[1], std::log(0.25) * kUnitsPerLogOdds, 0.5);
  EXPECT_EQ(control_points[2], 1);  // known
  EXPECT_NEAR(control_points[3], std::log(7 / 3.0) * kUnitsPerLogOdds, 0.5);
  EXPECT_EQ(control_points[4], std::lround(3.2 * kUnitsPerLogOdds));
}

TEST(RosGridTest, GridsThatNoMapHoldsAreRefused) {
  const MapOptions options{0.05, {}};
  const auto error = [&](double cell_m, Pose2 pose) {
    return TilesOf(Room(cell_m, pose), {}, options).status().ToString();
  };
  EXPECT_NE(error(0.0001, {}).find("are the finest"), std::string::npos);
  EXPECT_NE(error(500, {}).find("Is the resolution of 500 m per cell right?"), std::string::npos);
  EXPECT_NE(error(0.05, {{2e7, 0}, 0}).find("where no map reaches"), std::string::npos);
  EXPECT_NE(error(1e308, {}).find("where no map reaches"), std::string::npos);
  EXPECT_TRUE(TilesOf(Room(0.05, {{-1e7, 1e7}, 1}), {}, options).ok());
}

}  // namespace splinemap::ros_grid_test
