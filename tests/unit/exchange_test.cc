#include <gtest/gtest.h>
#include <png.h>
#include <tiffio.h>

#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <map>
#include <random>
#include <sstream>
#include <vector>

#include "lib/exchange/csv.h"
#include "lib/exchange/geotiff.h"
#include "lib/exchange/ros_map.h"
#include "lib/exchange/world_file.h"
#include "tests/support/full_disk.h"
#include "tests/support/map_writer.h"
#include "tests/support/random_map.h"
#include "tests/support/temporary_directory.h"

namespace splinemap::exchange_test {

// Tiles around the origin, with control points of every probability, saturated ones and holes.
std::shared_ptr<const MapView> RandomMap(int seed, double knot_interval_m) {
  std::mt19937_64 random(seed);
  MapWriter map({knot_interval_m, {}});
  Layer& layer = map.AddLayer({"robot", 1}, {1, 1});
  layer.BeginCommit();
  for (int k = 0; k < 4; ++k) layer.EditTile(RandomKey(random, 1)) = RandomTile(random);
  const ControlLimits moderate{-5 * kUnitsPerLogOdds, 5 * kUnitsPerLogOdds};
  for (int k = 0; k < 4; ++k) layer.EditTile(RandomKey(random, 1)) = RandomTile(random, moderate);
  return map.View();
}

struct Case {
  std::shared_ptr<const MapView> map;
  PixelGrid grid;
};

// Whole maps, and regions that are not square and lie partly outside.
std::vector<Case> Cases() {
  std::vector<Case> cases;
  for (int seed = 1; seed <= 6; ++seed) {
    const double knot_m = seed % 2 == 0 ? 0.05 : 0.11;
    const auto map = RandomMap(seed, knot_m);
    cases.push_back({map, *GridOfRegion(*map, std::nullopt, knot_m)});
    const Region region{-1.0 / seed - 0.3, -2.1, 0.7, -0.1 * seed};
    cases.push_back({map, *GridOfRegion(*map, region, knot_m / 2.7)});
    cases.push_back({map, *GridOfRegion(*map, Region{-0.2, -0.4, 5, 0.2}, 3 * knot_m)});
  }
  return cases;
}

// Counts what the cases have, so that no comparison is of nothing.
struct Seen {
  int known = 0;
  int unknown = 0;
};

template <typename Write>
std::string Written(const TemporaryDirectory& directory, const std::string& name, Write write) {
  auto file = NewFile::Create(directory.File(name));
  EXPECT_TRUE(file.ok());
  EXPECT_TRUE(write(*file).ok());
  EXPECT_TRUE(file->Commit().ok());
  return directory.File(name);
}

// ---- The reader's side of map_server, from its documentation: the value of each cell, cell (0, 0)
// at the lower left, where a pixel is grey[] with alpha[], row 0 at the top.

struct Picture {
  int width = 0;
  int height = 0;
  std::vector<int> grey;
  std::vector<int> alpha;
};

struct Grid {
  int width = 0;
  int height = 0;
  double resolution = 0;
  double origin[3] = {};
  std::vector<int> cells;
};

Picture ReadPgm(const std::string& path) {
  std::istringstream in(*ReadFile(path));
  std::string magic;
  int maximum = 0;
  Picture picture;
  in >> magic >> picture.width >> picture.height >> maximum;
  EXPECT_EQ(magic, "P5");
  EXPECT_EQ(maximum, 255);
  in.get();
  for (char c; in.get(c);) picture.grey.push_back(static_cast<unsigned char>(c));
  picture.alpha.assign(picture.grey.size(), 255);
  return picture;
}

Picture ReadPng(const std::string& path) {
  png_image image{};
  image.version = PNG_IMAGE_VERSION;
  EXPECT_NE(png_image_begin_read_from_file(&image, path.c_str()), 0);
  EXPECT_EQ(image.format, PNG_FORMAT_RGBA);
  std::vector<png_byte> bytes(PNG_IMAGE_SIZE(image));
  EXPECT_NE(png_image_finish_read(&image, nullptr, bytes.data(), 0, nullptr), 0);
  Picture picture{static_cast<int>(image.width), static_cast<int>(image.height), {}, {}};
  for (size_t k = 0; k < bytes.size(); k += 4) {
    EXPECT_TRUE(bytes[k] == bytes[k + 1] && bytes[k] == bytes[k + 2]);
    picture.grey.push_back(bytes[k]);
    picture.alpha.push_back(bytes[k + 3]);
  }
  return picture;
}

enum class Reader { kMapServer, kNav2 };

int Interpret(Reader reader, const std::string& mode, double grey, int alpha, double free_thresh,
              double occupied_thresh) {
  const bool is_nav2 = reader == Reader::kNav2;
  if (mode == "raw") {
    // map_server stores the byte in an int8; nav2 keeps 0 to 100.
    const int value = static_cast<int>(grey);
    return is_nav2 ? (value <= 100 ? value : -1) : static_cast<int8_t>(value);
  }
  const double occ = (255 - grey) / 255.0;
  if (is_nav2 && mode == "scale" && alpha != 255) return -1;
  if (occ > occupied_thresh) return 100;
  if (occ < free_thresh) return 0;
  if (mode == "trinary" || alpha < 1) return -1;
  const double ratio = (occ - free_thresh) / (occupied_thresh - free_thresh);
  return is_nav2 ? static_cast<int>(std::rint(100 * ratio)) : static_cast<int>(99 * ratio);
}

// Reads the pair of files.
Grid ReadRosMap(Reader reader, const std::string& yaml_path) {
  std::map<std::string, std::string> yaml;
  std::istringstream lines(*ReadFile(yaml_path));
  for (std::string line; std::getline(lines, line);) {
    const size_t colon = line.find(": ");
    yaml[line.substr(0, colon)] = line.substr(colon + 2);
  }
  EXPECT_EQ(yaml["negate"], "0");
  Grid grid;
  grid.resolution = std::strtod(yaml["resolution"].c_str(), nullptr);
  EXPECT_EQ(std::sscanf(yaml["origin"].c_str(), "[%lf, %lf, %lf]", &grid.origin[0], &grid.origin[1],
                        &grid.origin[2]),
            3);
  const std::string image = std::filesystem::path(yaml_path).replace_filename(yaml["image"]);
  const Picture picture = image.ends_with(".png") ? ReadPng(image) : ReadPgm(image);
  grid.width = picture.width;
  grid.height = picture.height;
  EXPECT_EQ(picture.grey.size(), size_t{1} * grid.width * grid.height);
  for (int j = 0; j < grid.height; ++j) {
    for (int i = 0; i < grid.width; ++i) {
      const int k = (grid.height - 1 - j) * grid.width + i;
      grid.cells.push_back(Interpret(reader, yaml["mode"], picture.grey[k], picture.alpha[k],
                                     std::strtod(yaml["free_thresh"].c_str(), nullptr),
                                     std::strtod(yaml["occupied_thresh"].c_str(), nullptr)));
    }
  }
  return grid;
}

Grid RosRoundTrip(const Case& c, RosMode mode, Reader reader) {
  const TemporaryDirectory directory;
  const std::string image = "lab" + RosImageExtension(mode);
  Written(directory, image,
          [&](NewFile& file) { return WriteRosImage(*c.map, c.grid, mode, file); });
  EXPECT_TRUE(WriteFile(directory.File("lab.yaml"), *RosYaml(c.grid, mode, image)).ok());
  return ReadRosMap(reader, directory.File("lab.yaml"));
}

// Calls check(cell, sample) with the surface at the centre of each cell, as ROS places it.
template <typename Check>
void ForEachRosCell(RosMode mode, Check check) {
  Seen seen;
  for (const Case& c : Cases()) {
    for (const Reader reader : {Reader::kMapServer, Reader::kNav2}) {
      const Grid grid = RosRoundTrip(c, mode, reader);
      ASSERT_EQ(grid.width, c.grid.width);
      ASSERT_EQ(grid.height, c.grid.height);
      ASSERT_EQ(grid.resolution, c.grid.pixel_m);
      ASSERT_EQ(grid.origin[0], c.grid.left_m);
      ASSERT_EQ(grid.origin[1], c.grid.bottom_m());
      ASSERT_EQ(grid.origin[2], 0);
      for (int j = 0; j < grid.height; ++j) {
        for (int i = 0; i < grid.width; ++i) {
          const double x_m = grid.origin[0] + (i + 0.5) * grid.resolution;
          const double y_m = grid.origin[1] + (j + 0.5) * grid.resolution;
          const SurfaceSample sample = c.map->Evaluate(x_m, y_m);
          check(grid.cells[j * grid.width + i], sample);
          ++(sample.known ? seen.known : seen.unknown);
        }
      }
    }
  }
  EXPECT_GT(seen.known, 10'000);
  EXPECT_GT(seen.unknown, 10'000);
}

constexpr double kRounding = 1e-6;  // of a probability, from the nanometre of a centre

TEST(RosMapTest, TrinaryCellsReadAsOccupiedFreeAndUnknown) {
  int cells_of[3] = {};
  ForEachRosCell(RosMode::kTrinary, [&](int cell, const SurfaceSample& sample) {
    const double p = Probability(sample.log_odds);
    if (std::abs(p - 0.65) < kRounding || std::abs(p - 0.196) < kRounding) return;
    const int expected = !sample.known ? -1 : p > 0.65 ? 100 : p < 0.196 ? 0 : -1;
    EXPECT_EQ(cell, expected) << p;
    ++cells_of[cell == -1 ? 0 : cell == 0 ? 1 : 2];
  });
  for (const int cells : cells_of) EXPECT_GT(cells, 1'000);
}

TEST(RosMapTest, ScaleCellsReadAsTheProbabilityInPerCent) {
  int between = 0;
  ForEachRosCell(RosMode::kScale, [&](int cell, const SurfaceSample& sample) {
    if (!sample.known) {
      EXPECT_EQ(cell, -1);
      return;
    }
    const double p = Probability(sample.log_odds);
    EXPECT_LT(cell, 100 * p + 0.9);
    EXPECT_GT(cell, 100 * p - 2.2);  // map_server spans 0 .. 99 and cuts off
    EXPECT_TRUE(p > 0.001 || cell == 0) << cell << " for " << p;
    EXPECT_TRUE(p < 0.999 || cell == 100) << cell << " for " << p;
    between += cell > 0 && cell < 100;
  });
  EXPECT_GT(between, 1'000);
}

TEST(RosMapTest, RawCellsReadAsTheProbabilityInPerCent) {
  ForEachRosCell(RosMode::kRaw, [&](int cell, const SurfaceSample& sample) {
    if (sample.known) {
      EXPECT_NEAR(cell, 100 * Probability(sample.log_odds), 0.5 + kRounding);
    } else {
      EXPECT_EQ(cell, -1);
    }
  });
}

TEST(RosMapTest, NumbersInTheYamlReadBackExactly) {
  std::mt19937_64 random(7);
  std::uniform_real_distribution<double> exponent(-6, 6);
  for (int k = 0; k < 1000; ++k) {
    PixelGrid grid{1, 1, 0, 0, std::pow(10, exponent(random))};
    grid.left_m = -std::pow(10, exponent(random));
    const std::string yaml = *RosYaml(grid, RosMode::kTrinary, "lab.pgm");
    double resolution = 0;
    double origin = 0;
    ASSERT_EQ(
        std::sscanf(yaml.c_str(), "image: lab.pgm\nmode: trinary\nresolution: %lf\norigin: [%lf",
                    &resolution, &origin),
        2)
        << yaml;
    EXPECT_EQ(resolution, grid.pixel_m);
    EXPECT_EQ(origin, grid.left_m);
  }
  // Without the point a number is text to YAML 1.1.
  EXPECT_NE(RosYaml({1, 1, 1e-5, 0, 1}, RosMode::kRaw, "x")->find("[1.e-05, -1.0, 0.0]"),
            std::string::npos);
}

TEST(RosMapTest, OddFileNamesAreQuoted) {
  const PixelGrid grid{1, 1, 0, 0, 1};
  EXPECT_TRUE(RosYaml(grid, RosMode::kRaw, "my-lab_2.pgm")->starts_with("image: my-lab_2.pgm\n"));
  EXPECT_TRUE(RosYaml(grid, RosMode::kRaw, "a: \"b\" #\\.pgm")
                  ->starts_with("image: \"a: \\\"b\\\" #\\\\.pgm\"\n"));
  EXPECT_TRUE(RosYaml(grid, RosMode::kRaw, "- x")->starts_with("image: \"- x\"\n"));
  EXPECT_TRUE(absl::IsInvalidArgument(RosYaml(grid, RosMode::kRaw, "a\nb").status()));
}

TEST(WorldFileTest, PlacesTheCentreOfTheUpperLeftPixel) {
  EXPECT_EQ(WorldFile({3, 2, -1.025, 4.075, 0.05}), "0.05\n0\n0\n-0.05\n-1\n4.05\n");
}

TEST(CsvTest, HasTheSurfaceAtEveryPoint) {
  Seen seen;
  for (const Case& c : Cases()) {
    const TemporaryDirectory directory;
    const std::string path = Written(directory, "lab.csv",
                                     [&](NewFile& file) { return WriteCsv(*c.map, c.grid, file); });
    std::istringstream lines(*ReadFile(path));
    std::string line;
    ASSERT_TRUE(std::getline(lines, line));
    EXPECT_EQ(line, "x_m,y_m,log_odds,probability,known");
    for (int j = 0; j < c.grid.height; ++j) {
      for (int i = 0; i < c.grid.width; ++i) {
        ASSERT_TRUE(std::getline(lines, line));
        double x_m, y_m, log_odds, probability;
        int known;
        ASSERT_EQ(std::sscanf(line.c_str(), "%lf,%lf,%lf,%lf,%d", &x_m, &y_m, &log_odds,
                              &probability, &known),
                  5);
        EXPECT_NEAR(x_m, c.grid.left_m + (i + 0.5) * c.grid.pixel_m, 1e-9);
        EXPECT_NEAR(y_m, c.grid.bottom_m() + (j + 0.5) * c.grid.pixel_m, 1e-8);
        const SurfaceSample sample = c.map->Evaluate(x_m, y_m);
        EXPECT_NEAR(log_odds, sample.log_odds, 0.51e-6);
        EXPECT_NEAR(probability, Probability(sample.log_odds), 0.51e-6);
        EXPECT_EQ(known == 1, sample.known);
        ++(sample.known ? seen.known : seen.unknown);
      }
    }
    EXPECT_FALSE(std::getline(lines, line));
  }
  EXPECT_GT(seen.known, 10'000);
  EXPECT_GT(seen.unknown, 10'000);
}

TEST(GeoTiffTest, HasTheSurfaceAndItsPlace) {
  TIFFSetWarningHandler(nullptr);  // of tags that libtiff does not know
  Seen seen;
  for (const Case& c : Cases()) {
    const TemporaryDirectory directory;
    const std::string path = Written(
        directory, "lab.tif", [&](NewFile& file) { return WriteGeoTiff(*c.map, c.grid, file); });
    const std::unique_ptr<TIFF, void (*)(TIFF*)> tiff(TIFFOpen(path.c_str(), "r"), TIFFClose);
    ASSERT_TRUE(tiff);
    uint32_t width = 0;
    uint32_t height = 0;
    ASSERT_TRUE(TIFFGetField(tiff.get(), TIFFTAG_IMAGEWIDTH, &width));
    ASSERT_TRUE(TIFFGetField(tiff.get(), TIFFTAG_IMAGELENGTH, &height));
    ASSERT_EQ(static_cast<int>(width), c.grid.width);
    ASSERT_EQ(static_cast<int>(height), c.grid.height);
    uint32_t count = 0;
    const double* scale = nullptr;  // ModelPixelScale
    ASSERT_TRUE(TIFFGetField(tiff.get(), 33550, &count, &scale));
    ASSERT_EQ(count, 3u);
    const double* tiepoint = nullptr;  // ModelTiepoint: the place of raster point (0, 0)
    ASSERT_TRUE(TIFFGetField(tiff.get(), 33922, &count, &tiepoint));
    ASSERT_EQ(count, 6u);
    EXPECT_EQ(scale[0], c.grid.pixel_m);
    EXPECT_EQ(scale[1], c.grid.pixel_m);
    EXPECT_EQ(tiepoint[0], 0);
    EXPECT_EQ(tiepoint[1], 0);
    EXPECT_EQ(tiepoint[3], c.grid.left_m);
    EXPECT_EQ(tiepoint[4], c.grid.top_m);
    const char* no_data = nullptr;
    ASSERT_TRUE(TIFFGetField(tiff.get(), 42113, &count, &no_data));
    EXPECT_STREQ(no_data, "nan");
    std::vector<float> values(width);
    for (uint32_t row = 0; row < height; ++row) {
      ASSERT_EQ(TIFFReadScanline(tiff.get(), values.data(), row), 1);
      for (uint32_t column = 0; column < width; ++column) {
        const double x_m = tiepoint[3] + (column + 0.5) * scale[0];
        const double y_m = tiepoint[4] - (row + 0.5) * scale[1];
        const SurfaceSample sample = c.map->Evaluate(x_m, y_m);
        ASSERT_EQ(std::isnan(values[column]), !sample.known);
        EXPECT_TRUE(!sample.known || std::abs(values[column] - sample.log_odds) < 1e-5);
        ++(sample.known ? seen.known : seen.unknown);
      }
    }
  }
  EXPECT_GT(seen.known, 10'000);
  EXPECT_GT(seen.unknown, 10'000);
}

TEST(ExchangeTest, AFullDiskIsToldByEveryFormat) {
  const Case c = Cases().front();
  const auto expect_failure = [&](auto write) {
    const TemporaryDirectory directory;
    auto file = NewFile::Create(directory.File("map"));
    ASSERT_TRUE(file.ok());
    const FullDisk full_disk;
    absl::Status status = write(*file);
    if (status.ok()) status = file->Commit();
    EXPECT_TRUE(absl::IsUnavailable(status)) << status;
  };
  expect_failure([&](NewFile& file) { return WriteCsv(*c.map, c.grid, file); });
  expect_failure([&](NewFile& file) { return WriteGeoTiff(*c.map, c.grid, file); });
  for (const RosMode mode : {RosMode::kTrinary, RosMode::kScale}) {
    expect_failure([&](NewFile& file) { return WriteRosImage(*c.map, c.grid, mode, file); });
  }
}

}  // namespace splinemap::exchange_test
