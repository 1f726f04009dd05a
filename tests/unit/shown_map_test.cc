#include "services/viewer/shown_map.h"

#include <gtest/gtest.h>

#include <condition_variable>
#include <mutex>

#include "lib/mapping/past_map.h"
#include "splinemap/file.h"
#include "splinemap/scan_archive.h"
#include "tests/support/temporary_directory.h"

namespace splinemap::shown_map_test {

using std::chrono::seconds;

// A scan of a round room each second, along which the robot moves.
LayerSnapshot LayerOf(const std::string& name, int scans) {
  ScanArchive archive;
  for (int k = 0; k < scans; ++k) {
    auto scan = std::make_shared<PosedScan>();
    scan->utime = seconds(1000 + k);
    scan->world_T_robot = FixedPose2::Nearest({{0.02 * k, 0}, 0.01 * k});
    scan->robot_T_sensor.resize(1);
    for (int n = 0; n < 40; ++n) {
      scan->beams.push_back(
          {2.5F, 0.15F * static_cast<float>(n), Utime(0), true, static_cast<uint16_t>(n)});
    }
    archive.Add(std::move(scan), {});
  }
  LayerSnapshot layer{{name, 7}, {1, 1}, static_cast<uint64_t>(scans), {}};
  layer.tiles = *FoldArchive(archive, {});
  layer.archive = std::make_shared<ScanArchive>(std::move(archive));
  return layer;
}

class ShownMapTest : public testing::Test {
 protected:
  void Open(std::vector<LayerSnapshot> layers) {
    set_ = {.options = {}, .layers = std::move(layers)};
    auto file = MapFile::Open(directory_.File("map"));
    ASSERT_TRUE(file.ok());
    ASSERT_TRUE(file->Save(set_).ok());
    ASSERT_TRUE(file->Close().ok());
    auto map = OpenMap(directory_.File("map"), [this] {
      const std::lock_guard lock(mutex_);
      changed_.notify_all();
    });
    ASSERT_TRUE(map.ok()) << map.status();
    map_ = *std::move(map);
  }

  // What is there once all that was wanted is made, or cannot be.
  MapTimes Settled() {
    std::unique_lock lock(mutex_);
    MapTimes times;
    EXPECT_TRUE(changed_.wait_for(lock, seconds(20), [&] {
      times = *map_->Times();
      return times.wanted == times.shown || !times.problem.empty();
    }));
    return times;
  }

  void ExpectMapOf(const LayerSet& set) {
    EXPECT_TRUE(DifferentTiles(map_->View()->tiles, ViewOf(set)->tiles).empty());
    EXPECT_TRUE(DifferentTiles(map_->Layers().layers[0].tiles, set.layers[0].tiles).empty());
  }

  const TemporaryDirectory directory_;
  LayerSet set_;
  std::mutex mutex_;
  std::condition_variable changed_;
  std::unique_ptr<ShownMap> map_;
};

TEST_F(ShownMapTest, TheMapIsShownAsItWasAndAsItIs) {
  Open({LayerOf("one", 60), LayerOf("two", 90)});
  const MapTimes times = *map_->Times();
  EXPECT_EQ(times.first, seconds(1000));
  EXPECT_EQ(times.last, seconds(1089));
  EXPECT_EQ(times.shown, std::nullopt);
  ExpectMapOf(set_);
  PastMap past(set_);
  for (const int time_s : {1030, 1070, 1010}) {
    map_->ShowAt(seconds(time_s));
    EXPECT_EQ(Settled().shown, seconds(time_s));
    ExpectMapOf(*past.At(seconds(time_s)));
  }
  map_->ShowAt(std::nullopt);
  EXPECT_EQ(Settled().shown, std::nullopt);
  ExpectMapOf(set_);
}

TEST_F(ShownMapTest, TimesBeyondTheScansAreTheirFirstAndNow) {
  Open({LayerOf("one", 60)});
  map_->ShowAt(Utime::min());
  EXPECT_EQ(Settled().shown, seconds(1000));
  map_->ShowAt(Utime::max());
  EXPECT_EQ(Settled().shown, std::nullopt);
  ExpectMapOf(set_);
}

TEST_F(ShownMapTest, OfManyWishesTheNewestIsShown) {
  Open({LayerOf("one", 200)});
  for (int k = 0; k < 500; ++k) map_->ShowAt(seconds(1000 + 7 * k % 200));
  map_->ShowAt(seconds(1123));
  EXPECT_EQ(Settled().shown, seconds(1123));
  ExpectMapOf(*PastMap(set_).At(seconds(1123)));
  map_->ShowAt(seconds(1010));
  map_.reset();  // while it is made
}

TEST_F(ShownMapTest, WhatCannotBeMadeIsSaidAndTheMapStays) {
  LayerSnapshot tiles_alone = LayerOf("imported", 10);
  tiles_alone.archive = nullptr;
  Open({LayerOf("one", 60), tiles_alone});
  map_->ShowAt(seconds(1010));
  const MapTimes times = Settled();
  EXPECT_EQ(times.shown, std::nullopt);
  EXPECT_EQ(times.wanted, seconds(1010));
  EXPECT_NE(times.problem.find("layer imported: the map keeps no scans"), std::string::npos);
  ExpectMapOf(set_);
  map_->ShowAt(std::nullopt);
  EXPECT_EQ(Settled().problem, "");
}

TEST_F(ShownMapTest, AMapWithoutScansHasNoTimes) {
  LayerSnapshot layer = LayerOf("imported", 10);
  layer.archive = nullptr;
  Open({layer});
  EXPECT_FALSE(map_->Times().has_value());
  map_->ShowAt(seconds(1010));
  ExpectMapOf(set_);
}

}  // namespace splinemap::shown_map_test
