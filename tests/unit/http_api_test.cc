#include "services/viewer/http_api.h"

#include <png.h>

#include <nlohmann/json.hpp>

#include "lib/base/host_clock.h"
#include "lib/render/raster.h"
#include "services/viewer/state_json.h"
#include "splinemap/file.h"
#include "splinemap/local_map.h"
#include "tests/support/map_writer.h"
#include "tests/support/placement.h"
#include "tests/support/random_map.h"
#include "tests/support/temporary_directory.h"

namespace splinemap::http_api_test {

using nlohmann::json;

// A map file of four layers, as the viewer shows it.
class HttpApiTest : public testing::Test {
 protected:
  void SetUp() override {
    std::mt19937_64 random(1);
    MapWriter writer({0.05, {-2560, 2560}});
    for (const char* name : {"one", "two", "three", "four"}) {
      Layer& layer = writer.AddLayer({name, 7}, {1, 1});
      layer.BeginCommit();
      for (const TileKey key : {TileKey{0, 0}, {-1, 0}, {5, 2}})
        layer.EditTile(key) = RandomTile(random, {-2560, 2560});
    }
    SettingsTable settings;
    settings.Merge({"two", 7}, {.placement = ShiftBy(3, -2), .counter = 1});
    settings.Merge({"three", 7}, {.placement = PlacedAt(1.5, -0.4, 90), .counter = 1});
    settings.Merge({"four", 7},
                   {.muted = true, .placement = PlacedAt(0.15, -0.1, 30), .counter = 1});
    writer.SetSettings(settings);
    auto file = MapFile::Open(directory_.File("map"));
    ASSERT_TRUE(file.ok());
    ASSERT_TRUE(file->Save(writer.Layers()).ok());
    ASSERT_TRUE(file->Close().ok());
    auto map = OpenMap(directory_.File("map"), [] {});
    ASSERT_TRUE(map.ok()) << map.status();
    map_ = *std::move(map);
    SurfaceLevels levels;
    while (levels.Advance(map_->View()->tiles, 0, 1000)) {
    }
    sum_.Set(levels, map_->View()->options);
    api_ = std::make_unique<HttpApi>(*map_, sum_);
  }

  HttpAnswer Get(const std::string& target) { return api_->Get(*HttpTarget::Parse(target)); }
  json GetJson(const std::string& target) {
    const HttpAnswer answer = Get(target);
    EXPECT_EQ(answer.status, 200) << answer.body;
    return json::parse(answer.body);
  }
  // Grey of each pixel, and the picture's width.
  static std::vector<uint8_t> Greys(const std::string& png, int& width) {
    png_image image{};
    image.version = PNG_IMAGE_VERSION;
    EXPECT_NE(png_image_begin_read_from_memory(&image, png.data(), png.size()), 0);
    image.format = PNG_FORMAT_RGB;
    std::vector<uint8_t> pixels(PNG_IMAGE_SIZE(image));
    EXPECT_NE(png_image_finish_read(&image, nullptr, pixels.data(), 0, nullptr), 0);
    width = static_cast<int>(image.width);
    return pixels;
  }

  const TemporaryDirectory directory_;
  std::unique_ptr<ShownMap> map_;
  SumLevels sum_;
  std::unique_ptr<HttpApi> api_;
};

TEST_F(HttpApiTest, APointIsTheSurfaceAndItsLayers) {
  const json answer = GetJson("/api/query?x=0.73&y=0.41");
  const SurfaceSample sample = map_->View()->Evaluate(0.73, 0.41);
  EXPECT_EQ(answer["log_odds"], sample.log_odds);
  EXPECT_EQ(answer["probability"], Probability(sample.log_odds));
  EXPECT_EQ(answer["gradient_per_m"][0], sample.gradient_per_m.x());
  EXPECT_EQ(answer["known"], true);
  ASSERT_EQ(answer["layers"].size(), 4);
  EXPECT_EQ(answer["layers"][0]["key"], "one@0000000000000007");
  // Nothing is clamped here, so the layers are what the sum is made of.
  double sum = 0;
  for (const json& layer : answer["layers"]) {
    if (layer["is_summed"].get<bool>()) sum += layer["log_odds"].get<double>();
  }
  EXPECT_NEAR(sum, sample.log_odds, 1.5);
}

TEST_F(HttpApiTest, RaysDistancesAndSegmentsAreThoseOfQueries) {
  const json ray = GetJson("/api/ray?x=0.73&y=0.41&bearing_deg=90&range=2");
  RaysQuery rays;
  rays.rays = {{{0.73, 0.41}, M_PI / 2, 2}};
  EXPECT_NEAR(ray["range_m"].get<double>(), map_->map().Ask(rays)->ends[0].range_m, 1e-12);
  const json distance = GetJson("/api/distance?x=3&y=3&max=9");
  DistancesQuery distances;
  distances.points_m = {{3, 3}};
  distances.max_distance_m = 9;
  EXPECT_EQ(distance["distance_m"], map_->map().Ask(distances)->distances[0].distance_m);
  const json check = GetJson("/api/check?x0=0.7&y0=0.4&x1=3&y1=3&radius=0.1");
  SweepsQuery sweeps;
  sweeps.sweeps = {{{{0.7, 0.4}, {3, 3}}, 0.1}};
  const SweepsQuery::Result result = map_->map().Ask(sweeps)->results[0];
  EXPECT_EQ(check["free_m"], result.free_m);
  EXPECT_EQ(check["contact"]["x_m"], result.contact_m.x());
}

TEST_F(HttpApiTest, PicturesAreTheRenderedSurface) {
  const HttpAnswer answer = Get("/map.png?bbox=-1,-0.5,3,2.5&px=200");
  ASSERT_EQ(answer.status, 200);
  EXPECT_EQ(answer.content_type, "image/png");
  int width = 0;
  const std::vector<uint8_t> pixels = Greys(answer.body, width);
  ASSERT_EQ(width, 200);
  const Raster expected = RenderMap(*map_->View(), {200, 150, -1, 2.5, 0.02});
  int known = 0;
  for (size_t k = 0; k < expected.pixels.size(); ++k) {
    if (expected.pixels[k] == Raster::kUnknown) continue;
    ++known;
    ASSERT_EQ(pixels[3 * k], expected.pixels[k]) << k;
  }
  EXPECT_GT(known, 1000);
}

TEST_F(HttpApiTest, TilesOfWebMapsLieWhereTheMapIs) {
  // Zoom 22: tiles of 9.55 m; the one to the upper right of the origin.
  const int64_t middle = int64_t{1} << 21;
  const HttpAnswer answer = Get(fmt::format("/tiles/22/{}/{}.png", middle, middle - 1));
  ASSERT_EQ(answer.status, 200) << answer.body;
  int width = 0;
  const std::vector<uint8_t> pixels = Greys(answer.body, width);
  ASSERT_EQ(width, 256);
  const double pixel_m = 2 * 20037508.342789244 / std::ldexp(1, 30);
  int known = 0;
  for (int column = 0; column < 256; ++column) {
    for (int row = 0; row < 256; ++row) {
      const SurfaceSample sample =
          map_->View()->Evaluate((column + 0.5) * pixel_m, (256 - row - 0.5) * pixel_m);
      if (!sample.known) continue;
      ++known;
      ASSERT_NEAR(pixels[3 * (row * 256 + column)], KnownPixel(sample.log_odds), 1)
          << column << " " << row;
    }
  }
  EXPECT_GT(known, 100);
}

TEST_F(HttpApiTest, WhatCannotBeAnsweredIsSaid) {
  for (const char* target :
       {"/api/query", "/api/query?x=1",
        "/api/query?x=1&y=", "/api/ray?x=0&y=0&bearing_deg=0&range=-1",
        "/api/distance?x=0&y=0&max=1e9", "/api/check?x0=0&y0=0&x1=1&y1=1&radius=-1", "/map.png",
        "/map.png?bbox=0,0,1&px=10", "/map.png?bbox=1,1,0,0&px=10", "/map.png?bbox=0,0,1,1&px=0",
        "/map.png?bbox=0,0,1,1&px=100000", "/map.png?bbox=0,0,0.001,100&px=100",
        "/map.png?bbox=nan,0,1,1&px=10"}) {
    const HttpAnswer answer = Get(target);
    EXPECT_EQ(answer.status, 400) << target;
    EXPECT_FALSE(json::parse(answer.body)["error"].get<std::string>().empty()) << target;
  }
  for (const char* target :
       {"/", "/../etc/passwd", "/tiles/", "/tiles/1/2/3.png", "/tiles/99/0/0.png",
        "/tiles/3/-1/0.png", "/tiles/3/0/0.svg", "/tiles/3/0/0.png/x"}) {
    EXPECT_EQ(Get(target).status, 404) << target;
  }
}

TEST_F(HttpApiTest, ADamagedFileIsNotShownInSilence) {
  std::string bytes = *ReadFile(directory_.File("map"));
  for (size_t k = bytes.size() / 2; k < bytes.size(); ++k) bytes[k] = 'x';
  ASSERT_TRUE(WriteFile(directory_.File("damaged"), bytes).ok());
  EXPECT_FALSE(OpenMap(directory_.File("damaged"), [] {}).ok());
  EXPECT_TRUE(absl::IsNotFound(OpenMap(directory_.File("none"), [] {}).status()));
}

TEST_F(HttpApiTest, SectionsOfAFileAreJson) {
  SurfaceLevels levels;
  while (levels.Advance(map_->View()->tiles, 0, 1000)) {
  }
  const json map = json::parse(MapJson({"file", "a\xff<b>"}, *map_, *map_->View(), levels.box()));
  EXPECT_EQ(map["source"], "file");
  EXPECT_EQ(map["knot_interval_m"], 0.05);
  EXPECT_LT(map["bounds"]["x0_m"].get<double>(), -1.5);
  const json layers = json::parse(LayersJson(*map_, nullptr));
  ASSERT_EQ(layers.size(), 4);
  EXPECT_NEAR(layers[3]["placement"]["x_m"].get<double>(), 0.15, 1e-6);
  EXPECT_NEAR(layers[3]["placement"]["yaw_rad"].get<double>(), M_PI / 6, 1e-8);
  EXPECT_TRUE(layers[3]["is_approximate"].get<bool>());
  EXPECT_FALSE(layers[2]["is_approximate"].get<bool>());
}

}  // namespace splinemap::http_api_test
