#include "lib/mapping/past_map.h"

#include <gtest/gtest.h>

#include <memory>
#include <random>

#include "lib/mapping/archive_edit.h"
#include "splinemap/scan_archive.h"

namespace splinemap::past_map_test {

using std::chrono::seconds;

// A scan of a round room, along which the robot moves.
std::shared_ptr<const PosedScan> ScanAt(int second) {
  auto scan = std::make_shared<PosedScan>();
  scan->utime = seconds(second);
  scan->world_T_robot = FixedPose2::Nearest({{0.02 * second, 0}, 0.01 * second});
  scan->robot_T_sensor.resize(1);
  for (int n = 0; n < 40; ++n) {
    scan->beams.push_back(
        {2.5F, 0.15F * static_cast<float>(n), Utime(0), true, static_cast<uint16_t>(n)});
  }
  return scan;
}

LayerSnapshot LayerOf(const std::string& name, const std::vector<int>& times_s) {
  ScanArchive archive;
  for (const int time_s : times_s) archive.Add(ScanAt(time_s), {});
  LayerSnapshot layer{{name, 7}, {1, 1}, static_cast<uint64_t>(archive.num_scans()), {}};
  layer.tiles = *FoldArchive(archive, {});
  layer.archive = std::make_shared<ScanArchive>(std::move(archive));
  return layer;
}

std::vector<int> Range(int from, int to) {
  std::vector<int> times_s;
  for (int time_s = from; time_s < to; ++time_s) times_s.push_back(time_s);
  return times_s;
}

// Each layer is the fold of its scans until then.
void ExpectMapOf(const LayerSet& now, Utime utime, const absl::StatusOr<LayerSet>& then) {
  ASSERT_TRUE(then.ok()) << then.status();
  ASSERT_EQ(then->layers.size(), now.layers.size());
  for (size_t k = 0; k < now.layers.size(); ++k) {
    const ScanArchive& archive = *now.layers[k].archive;
    const ScanArchive until = WindBackTo(archive, utime)->Apply(archive);
    EXPECT_EQ(then->layers[k].archive->num_scans(), until.num_scans());
    EXPECT_TRUE(DifferentTiles(then->layers[k].tiles, *FoldArchive(until, {})).empty())
        << now.layers[k].id.name << " at " << utime.count();
  }
}

// Scans of "mixed" come out of order, and some at one time.
LayerSet TwoLayers() {
  std::vector<int> mixed = Range(50, 150);
  std::mt19937_64 random(1);
  for (int& time_s : mixed) time_s = static_cast<int>(static_cast<uint64_t>(time_s) + random() % 9);
  return {.options = {}, .layers = {LayerOf("plain", Range(0, 100)), LayerOf("mixed", mixed)}};
}

TEST(PastMapTest, EachTimeIsTheFoldOfTheScansUntilThen) {
  const LayerSet now = TwoLayers();
  PastMap past(now);
  std::mt19937_64 random(2);
  for (int n = 0; n < 24; ++n) {
    const Utime utime = seconds(static_cast<int64_t>(random() % 170)) - seconds(5);
    ExpectMapOf(now, utime, past.At(utime));
  }
  ExpectMapOf(now, seconds(1000), past.At(seconds(1000)));
}

TEST(PastMapTest, WhatWasCancelledIsGoneOnWith) {
  const LayerSet now = TwoLayers();
  PastMap past(now);
  std::mt19937_64 random(3);
  for (int n = 0; n < 24; ++n) {
    const Utime utime = seconds(static_cast<int64_t>(random() % 160));
    const auto end = static_cast<int64_t>(random() % 100);
    const auto cancelled =
        past.At(utime, [&](int64_t folded, int64_t) { return folded >= end; }).status();
    EXPECT_TRUE(cancelled.ok() || absl::IsCancelled(cancelled)) << cancelled;
    if (n % 3 != 0) continue;
    const Utime next = seconds(static_cast<int64_t>(random() % 160));
    ExpectMapOf(now, next, past.At(next));
  }
}

TEST(PastMapTest, ForwardsOnlyWhatIsNewIsFolded) {
  PastMap past({.options = {}, .layers = {LayerOf("robot", Range(0, 100))}});
  ASSERT_TRUE(past.At(seconds(79)).ok());
  int64_t first = -1;
  int64_t last = -1;
  const auto note = [&](int64_t folded, int64_t scans) {
    if (first < 0) first = folded;
    last = folded;
    EXPECT_EQ(scans, 90);
    return false;
  };
  ASSERT_TRUE(past.At(seconds(89), note).ok());
  EXPECT_EQ(first, 80);
  EXPECT_EQ(last, 89);
}

TEST(PastMapTest, ALayerWithoutItsScansIsNamed) {
  LayerSet now = TwoLayers();
  now.layers[1].archive = nullptr;
  const absl::Status status = PastMap(now).At(seconds(10)).status();
  EXPECT_TRUE(absl::IsFailedPrecondition(status));
  EXPECT_NE(status.message().find("layer mixed: the map keeps no scans of it"), std::string::npos)
      << status;
}

TEST(PastMapTest, ScansThatAreNotKeptAnyMoreAreNamed) {
  LayerSet now = TwoLayers();
  auto archive = std::make_shared<ScanArchive>(*now.layers[0].archive);
  archive->base.tiles = now.layers[0].tiles;
  archive->base.scans = 70;
  archive->base.newest = seconds(40);
  now.layers[0].archive = archive;
  const absl::Status status = PastMap(now).At(seconds(30)).status();
  EXPECT_TRUE(absl::IsFailedPrecondition(status));
  EXPECT_NE(status.message().find("the oldest 70 scans"), std::string::npos) << status;
}

TEST(PastMapTest, TimesAreThoseOfAllLayersThatKeepScans) {
  LayerSet now = TwoLayers();
  EXPECT_EQ(TimesOf(now)->first, seconds(0));
  EXPECT_GE(TimesOf(now)->last, seconds(149));
  now.layers[1].archive = nullptr;
  EXPECT_EQ(TimesOf(now)->last, seconds(99));
  now.layers[0].archive = nullptr;
  EXPECT_TRUE(absl::IsNotFound(TimesOf(now).status()));
}

}  // namespace splinemap::past_map_test
