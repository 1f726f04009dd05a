#include <gtest/gtest.h>
#include <png.h>

#include <algorithm>
#include <numbers>
#include <string>
#include <vector>

#include "lib/render/overlay.h"
#include "lib/render/raster.h"
#include "lib/render/terminal.h"
#include "tests/support/map_writer.h"
#include "tests/support/temporary_directory.h"

namespace splinemap::render_test {

// Free from knot (-4, -2) to (10, 6), with an occupied block around (5, 3).
std::shared_ptr<const MapView> Room() {
  MapWriter map({0.1, {}});
  Layer& layer = map.AddLayer({"robot", 1}, {1, 1});
  layer.BeginCommit();
  for (int j = -2; j <= 6; ++j) {
    for (int i = -4; i <= 10; ++i) {
      const bool occupied = std::abs(i - 5) <= 2 && std::abs(j - 3) <= 2;
      layer.EditTile(TileOf(i, j)).control_points[IndexInTile(i, j)] = occupied ? 5000 : -5000;
    }
  }
  return map.View();
}

TEST(RasterTest, CoversJustWhatWasTouched) {
  const auto grid = FittingGrid(*Room(), 2);
  ASSERT_TRUE(grid.ok());
  EXPECT_EQ(grid->width, 30);
  EXPECT_EQ(grid->height, 18);
  EXPECT_NEAR(grid->left_m, -0.45, 1e-12);
  EXPECT_NEAR(grid->top_m, 0.65, 1e-12);
  EXPECT_NEAR(grid->pixel_m, 0.05, 1e-12);
}

TEST(RasterTest, PixelsShowTheSurfaceAtTheirCentre) {
  const auto map = Room();
  const PixelGrid grid = *FittingGrid(*map, 3);
  const Raster raster = RenderMap(*map, grid);
  int occupied = 0;
  for (int row = 0; row < grid.height; ++row) {
    for (int column = 0; column < grid.width; ++column) {
      const double x_m = grid.left_m + (column + 0.5) * grid.pixel_m;
      const double y_m = grid.top_m - (row + 0.5) * grid.pixel_m;
      const double p = Probability(map->Evaluate(x_m, y_m).log_odds);
      EXPECT_NEAR(raster.at(column, row), 255 - 254 * p, 0.51);
      occupied += raster.at(column, row) < 10;
    }
  }
  EXPECT_GT(occupied, 50);
}

TEST(RasterTest, MarksThePixelsOfARegionAndAtLeastOne) {
  Raster raster = RenderMap(*Room(), *FittingGrid(*Room(), 2));
  const auto marked = [&] {
    return std::count(raster.marked.begin(), raster.marked.end(), Raster::Marker::kRed);
  };
  raster.Mark({-0.05, 0.15, 0.05, 0.25});  // about knot (0, 2)
  EXPECT_EQ(marked(), 4);
  EXPECT_EQ(raster.marked[size_t{8} * raster.grid.width + 8], Raster::Marker::kRed);
  EXPECT_EQ(raster.marked[size_t{9} * raster.grid.width + 9], Raster::Marker::kRed);
  raster.Mark({0.51, 0.01, 0.52, 0.02});
  EXPECT_EQ(marked(), 5);
  raster.Mark({100, 100, 101, 101});
  raster.Mark({-101, -101, -100, -100});
  EXPECT_EQ(marked(), 5);
}

TEST(RasterTest, FitsThePictureToASide) {
  EXPECT_EQ(FittingPixelsPerKnot(*Room(), 60), 4);  // the longer side is 15 knots
  EXPECT_EQ(FittingPixelsPerKnot(*Room(), 3), 0.2);
  EXPECT_EQ(FittingPixelsPerKnot(*Room(), 100'000), 8);
}

TEST(RasterTest, AnEmptyMapAndAHugePictureAreRefused) {
  MapWriter map({0.05, {}});
  map.AddLayer({"robot", 1}, {1, 1});
  EXPECT_TRUE(absl::IsFailedPrecondition(FittingGrid(*map.View(), 1).status()));
  EXPECT_TRUE(absl::IsInvalidArgument(FittingGrid(*Room(), 1e5).status()));
}

TEST(PngTest, HoldsTheRaster) {
  const TemporaryDirectory directory;
  const Raster raster{{2, 2, 0, 0, 1}, {Raster::kUnknown, 255, 1, 128}};
  {
    auto file = NewFile::Create(directory.File("map.png"));
    ASSERT_TRUE(file.ok());
    ASSERT_TRUE(WritePng(raster, *file).ok());
    ASSERT_TRUE(file->Commit().ok());
  }
  png_image image{};
  image.version = PNG_IMAGE_VERSION;
  ASSERT_NE(png_image_begin_read_from_file(&image, directory.File("map.png").c_str()), 0);
  image.format = PNG_FORMAT_RGB;
  std::vector<png_byte> pixels(PNG_IMAGE_SIZE(image));
  ASSERT_NE(png_image_finish_read(&image, nullptr, pixels.data(), 0, nullptr), 0);
  EXPECT_EQ(pixels, (std::vector<png_byte>{176, 190, 205, 255, 255, 255, 1, 1, 1, 128, 128, 128}));
}

TEST(TerminalTest, KeepsThinWallsWhenItShrinks) {
  Raster raster{{100, 100, 0, 0, 1}, std::vector<uint8_t>(10'000, 255)};
  for (int row = 0; row < 100; ++row) raster.pixels[row * 100 + 57] = 1;  // a wall of one pixel
  const std::string text = DrawInTerminal(raster, 20, 10, false);
  EXPECT_EQ(std::count(text.begin(), text.end(), '\n'), 10);
  EXPECT_EQ(std::count(text.begin(), text.end(), '#'), 10);
}

TEST(TerminalTest, StaysWithinTheWindow) {
  for (const auto& [width, height] : {std::pair{500, 20}, {20, 500}, {3, 3}, {79, 81}}) {
    const Raster raster{{width, height, 0, 0, 1},
                        std::vector<uint8_t>(size_t{1} * width * height, 9)};
    const std::string text = DrawInTerminal(raster, 40, 12, false);
    EXPECT_LE(std::count(text.begin(), text.end(), '\n'), 12);
    EXPECT_LE(text.find('\n'), 40u);
  }
}

TEST(OverlayTest, ShowsWhatEachMapHasWhereItLies) {
  const auto room = Room();
  // The room turned about its corner: b's knot (5, 3) lies at (-3, 5) of a.
  const Pose2 a_T_b{{0, 0}, std::numbers::pi / 2};
  const auto grid = GridAroundBoth(*room, *room, a_T_b, 1000);
  ASSERT_TRUE(grid.ok());
  EXPECT_NEAR(grid->left_m, -0.65, 0.02);
  EXPECT_NEAR(grid->top_m, 1.05, 0.02);
  const Overlay overlay = RenderBoth(*room, *room, a_T_b, *grid);
  const auto at = [&](double x_m, double y_m) {
    const auto column = static_cast<size_t>((x_m - grid->left_m) / grid->pixel_m);
    const auto row = static_cast<size_t>((grid->top_m - y_m) / grid->pixel_m);
    return overlay.pixels[row * grid->width + column];
  };
  EXPECT_EQ(at(0.5, 0.3), Overlay::kObstacleInA);
  EXPECT_EQ(at(-0.3, 0.5), Overlay::kObstacleInB);
  EXPECT_EQ(at(0.8, -0.1), Overlay::kFreeInA);
  EXPECT_EQ(at(-0.2, 0.9), Overlay::kFreeInB);
  EXPECT_EQ(at(0, 0), Overlay::kFree);
  EXPECT_EQ(at(0.8, 0.9), Overlay::kUnknown);
  const Overlay same = RenderBoth(*room, *room, {}, *FittingGrid(*room, 2));
  EXPECT_GT(std::count(same.pixels.begin(), same.pixels.end(), Overlay::kObstacle), 50);
  EXPECT_FALSE(GridAroundBoth(*room, MapView(), a_T_b, 1000).ok());
}

TEST(OverlayTest, IsWrittenAsAPicture) {
  const TemporaryDirectory folder;
  const Overlay overlay = RenderBoth(*Room(), *Room(), {}, *FittingGrid(*Room(), 2));
  const std::string path = folder.path() + "/both.png";
  auto file = NewFile::Create(path);
  ASSERT_TRUE(file.ok());
  ASSERT_TRUE(WritePng(overlay, *file).ok());
  ASSERT_TRUE(file->Commit().ok());
  png_image image{};
  image.version = PNG_IMAGE_VERSION;
  ASSERT_NE(png_image_begin_read_from_file(&image, path.c_str()), 0);
  image.format = PNG_FORMAT_RGB;
  std::vector<Overlay::Colour> pixels(overlay.pixels.size());
  ASSERT_EQ(PNG_IMAGE_SIZE(image), 3 * pixels.size());
  png_image_finish_read(&image, nullptr, pixels.data(), 0, nullptr);
  EXPECT_EQ(pixels, overlay.pixels);
}

}  // namespace splinemap::render_test
