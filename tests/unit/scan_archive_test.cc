#include "splinemap/scan_archive.h"

#include <gtest/gtest.h>

#include <cmath>
#include <fstream>
#include <random>

#include "lib/mapping/fold.h"
#include "tests/support/shared_data.h"

namespace splinemap::scan_archive_test {

bool Equal(const PosedScan& a, const PosedScan& b) {
  return a.channel == b.channel && a.utime == b.utime && a.world_T_robot == b.world_T_robot &&
         a.robot_T_sensor == b.robot_T_sensor &&
         std::equal(a.beams.begin(), a.beams.end(), b.beams.begin(), b.beams.end(),
                    [](const Beam& x, const Beam& y) {
                      return x.range_m == y.range_m && x.bearing_rad == y.bearing_rad &&
                             x.hit == y.hit && x.reading == y.reading;
                    });
}

// A kind of scanner by `channel`: whole centimetres, any floats from any direction, beams without
// hits of a robot that moves meanwhile.
std::shared_ptr<const PosedScan> RandomScan(int channel, int64_t utime, std::mt19937_64& random) {
  std::uniform_real_distribution<double> uniform(0, 1);
  auto scan = std::make_shared<PosedScan>();
  scan->channel = channel;
  scan->utime = Utime(utime);
  const double way = static_cast<double>(utime) * 1e-7;
  scan->world_T_robot = FixedPose2::Nearest({{2 * std::cos(way), 2 * std::sin(way)}, way});
  for (int k = 0; k < 60; ++k) {
    if (uniform(random) < 0.1) continue;  // no return
    Beam beam;
    beam.reading = static_cast<uint16_t>(k);
    beam.bearing_rad = static_cast<float>(channel == 1 ? 6.3 * uniform(random) : 0.1 * k);
    beam.range_m = channel == 0 ? static_cast<float>(std::round(300 + 500 * uniform(random)) * 0.01)
                                : static_cast<float>(2 + 5 * uniform(random));
    beam.hit = channel != 2 || uniform(random) < 0.8;
    scan->beams.push_back(beam);
    if (channel == 2) {
      scan->robot_T_sensor.push_back(FixedPose2::Nearest({{0.001 * k, 0.1}, 0.0002 * k}));
    }
  }
  if (channel != 2) scan->robot_T_sensor = {FixedPose2::Nearest({{0.2, 0}, 0.3})};
  return scan;
}

PosedScans RandomScans(int count, uint64_t seed) {
  std::mt19937_64 random(seed);
  PosedScans scans;
  for (int k = 0; k < count; ++k) {
    scans.push_back(RandomScan(static_cast<int>(random() % 3), 100'000 * k, random));
  }
  return scans;
}

ScanArchive ArchiveOf(const PosedScans& scans) {
  ScanArchive archive;
  for (const auto& scan : scans) archive.Add(scan, {});
  return archive;
}

PosedScans ScansOf(const ScanArchive& archive) {
  PosedScans scans;
  archive.ForEach([&](const PosedScan& scan, const BeamModelOptions&) {
    scans.push_back(std::make_shared<PosedScan>(scan));
  });
  return scans;
}

void ExpectEqual(const PosedScans& a, const PosedScans& b) {
  ASSERT_EQ(a.size(), b.size());
  for (size_t k = 0; k < a.size(); ++k) EXPECT_TRUE(Equal(*a[k], *b[k])) << "scan " << k;
}

TileTree FoldOf(const ScanArchive& archive) {
  const absl::StatusOr<TileTree> tiles = FoldArchive(archive, {});
  EXPECT_TRUE(tiles.ok()) << tiles.status();
  return tiles.value_or(TileTree());
}

TEST(ScanArchiveTest, GivesBackWhatWasAddedToTheLastBit) {
  const PosedScans scans = RandomScans(700, 1);
  const ScanArchive archive = ArchiveOf(scans);
  EXPECT_EQ(archive.num_scans(), 700);
  ExpectEqual(ScansOf(archive), scans);
  // As a file has it.
  ScanArchive read;
  for (const auto& block : archive.Blocks()) {
    const auto again = BlockOf(block->poses, *block->beams);
    ASSERT_TRUE(again.ok()) << again.status();
    read.Add(*again);
  }
  ExpectEqual(ScansOf(read), scans);
  EXPECT_LT(archive.bytes(), 700u * 60 * 8);
}

std::string Content(const std::string& name) {
  std::ifstream file(TestData(name), std::ios::binary);
  return {std::istreambuf_iterator<char>(file), {}};
}

// Of before scans had records.
TEST(ScanArchiveTest, ReadsEarlierBlocks) {
  const std::string poses = Content("scan_block_of_planes/poses");
  const std::string beams = Content("scan_block_of_planes/beams");
  const auto block = BlockOf(poses, beams);
  ASSERT_TRUE(block.ok()) << block.status();
  ExpectEqual(UnpackScans(**block), RandomScans(30, 20));
  ScanArchive archive;
  archive.Add(*block);
  EXPECT_EQ(*archive.Blocks().front()->beams, beams);
  for (size_t size = 0; size < beams.size(); size += 7) {
    EXPECT_FALSE(BlockOf(poses, beams.substr(0, size)).ok());
  }
}

TEST(ScanArchiveTest, AnotherBeamModelBeginsAnotherBlock) {
  const PosedScans scans = RandomScans(4, 2);
  BeamModelOptions paper;
  paper.update = BeamUpdate::kPaperLine;
  ScanArchive archive;
  archive.Add(scans[0], {});
  archive.Add(scans[1], paper);
  archive.Add(scans[2], paper);
  archive.Add(scans[3], {});
  std::vector<BeamUpdate> updates;
  archive.ForEach(
      [&](const PosedScan&, const BeamModelOptions& model) { updates.push_back(model.update); });
  EXPECT_EQ(updates,
            (std::vector<BeamUpdate>{BeamUpdate::kSignedDistance, BeamUpdate::kPaperLine,
                                     BeamUpdate::kPaperLine, BeamUpdate::kSignedDistance}));
}

TEST(ScanArchiveTest, OldSnapshotsStayAsTheyAre) {
  const PosedScans scans = RandomScans(600, 3);
  ScanArchive archive = ArchiveOf({scans.begin(), scans.begin() + 300});
  const ScanArchive before = archive;
  for (size_t k = 300; k < 600; ++k) archive.Add(scans[k], {});
  archive.TakeOldest();
  ExpectEqual(ScansOf(before), {scans.begin(), scans.begin() + 300});
  EXPECT_EQ(archive.scans_added(), 600);
  int64_t seen = 0;
  archive.ForEachAfter(590, [&](const PosedScan& scan, const BeamModelOptions&) {
    EXPECT_TRUE(Equal(scan, *scans[590 + seen]));
    ++seen;
  });
  EXPECT_EQ(seen, 10);
}

TEST(ScanArchiveTest, FilteredAndMovedAreWhatTheyWouldBeIfMadeSo) {
  const PosedScans scans = RandomScans(650, 4);
  const ScanArchive archive = ArchiveOf(scans);
  const auto is_kept = [](const ScanPose& pose) {
    return pose.utime < Utime(20'000'000) || pose.utime.count() % 300'000 == 0;
  };
  PosedScans kept;
  for (const auto& scan : scans) {
    if (is_kept({scan->utime, {}})) kept.push_back(scan);
  }
  ExpectEqual(ScansOf(archive.Filtered(is_kept)), kept);
  const auto move = [](const ScanPose& pose) {
    FixedPose2 moved = pose.world_T_robot;
    if (pose.utime > Utime(30'000'000)) moved.x += 12345;
    return moved;
  };
  PosedScans moved;
  for (const auto& scan : scans) {
    auto copy = std::make_shared<PosedScan>(*scan);
    copy->world_T_robot = move({scan->utime, scan->world_T_robot});
    moved.push_back(std::move(copy));
  }
  ExpectEqual(ScansOf(archive.Moved(move)), moved);
}

TEST(ScanArchiveTest, DamagedBytesAreRefusedOrGiveScansThatCanBe) {
  const auto block = ArchiveOf(RandomScans(50, 5)).Blocks().front();
  std::mt19937_64 random(6);
  int refused = 0;
  for (int round = 0; round < 400; ++round) {
    std::string poses = block->poses;
    std::string beams = *block->beams;
    std::string& damaged = round % 2 == 0 ? poses : beams;
    damaged[random() % damaged.size()] ^= static_cast<char>(1 << random() % 8);
    if (round % 5 == 0) damaged.resize(random() % damaged.size());
    const auto read = BlockOf(poses, beams);
    if (!read.ok()) {
      ++refused;
      continue;
    }
    for (const auto& scan : UnpackScans(**read)) {
      EXPECT_TRUE(scan->world_T_robot.IsValid());
      for (const Beam& beam : scan->beams) EXPECT_TRUE(beam.range_m >= 0 && beam.range_m <= 1000);
    }
  }
  EXPECT_GT(refused, 100);
  EXPECT_FALSE(BlockOf("", "").ok());
}

TEST(ScanArchiveTest, PosesAndTimesThatCannotBeAreRefused) {
  const auto block = ArchiveOf(RandomScans(3, 14)).Blocks().front();
  std::vector<ScanPose> poses = UnpackPoses(*block);
  EXPECT_TRUE(BlockOf(WithPoses(*block, poses)->poses, *block->beams).ok());
  poses[1].world_T_robot.x = FixedPose2::kMaxUnits + 1;
  EXPECT_FALSE(BlockOf(WithPoses(*block, poses)->poses, *block->beams).ok());
  poses[1].world_T_robot.x = 0;
  poses[2].utime = Utime(int64_t{1} << 61);
  EXPECT_FALSE(BlockOf(WithPoses(*block, poses)->poses, *block->beams).ok());
  poses.pop_back();  // one less than scans
  EXPECT_FALSE(BlockOf(WithPoses(*block, poses)->poses, *block->beams).ok());
}

TEST(FoldTest, ShortenedArchivesFoldToTheSameBytes) {
  const ScanArchive archive = ArchiveOf(RandomScans(900, 7));
  ScanArchive shortened = archive;
  Shorten(shortened, archive.bytes() / 2, {});
  EXPECT_LE(shortened.bytes(), archive.bytes() / 2);
  EXPECT_GT(shortened.base.scans, 0);
  EXPECT_EQ(shortened.base.scans + shortened.num_scans(), 900);
  EXPECT_TRUE(DifferentTiles(FoldOf(archive), FoldOf(shortened)).empty());
}

TEST(FoldTest, AFoldInPartsIsTheFold) {
  const PosedScans scans = RandomScans(500, 8);
  ScanArchive archive = ArchiveOf({scans.begin(), scans.begin() + 300});
  Fold fold(archive, {});
  ASSERT_TRUE(fold.Continue(archive).ok());
  for (size_t k = 300; k < 500; ++k) archive.Add(scans[k], {});
  Shorten(archive, archive.bytes() * 9 / 10, {});
  EXPECT_EQ(archive.num_scans(), 244);  // one block is gone, which was folded
  ASSERT_TRUE(fold.Continue(archive).ok());
  EXPECT_EQ(fold.scans_folded(), 500);
  EXPECT_TRUE(DifferentTiles(fold.Tiles(), FoldOf(ArchiveOf(scans))).empty());
}

TEST(FoldTest, PlacedAndPlacedBackIsAsBefore) {
  ScanArchive archive = ArchiveOf(RandomScans(200, 9));
  const TileTree before = FoldOf(archive);
  archive.map_T_world = FixedPose2::Nearest({{3, -1}, 0.5});
  EXPECT_FALSE(DifferentTiles(before, FoldOf(archive)).empty());
  archive.map_T_world = {};
  EXPECT_TRUE(DifferentTiles(before, FoldOf(archive)).empty());
}

TEST(FoldTest, WhatIsNotKeptCannotBePlaced) {
  ScanArchive archive = ArchiveOf(RandomScans(600, 10));
  Shorten(archive, archive.bytes() / 2, {});
  archive.map_T_world = FixedPose2::Nearest({{1, 0}, 0});
  const absl::Status status = FoldArchive(archive, {}).status();
  EXPECT_TRUE(absl::IsFailedPrecondition(status));
  EXPECT_NE(status.message().find("scans of the layer are not kept"), std::string::npos) << status;
}

TEST(FoldTest, ScansThatReachTooFarForTheKnotsAreRefused) {
  const ScanArchive archive = ArchiveOf(RandomScans(20, 11));
  MapOptions fine;
  fine.knot_interval_m = 0.001;
  EXPECT_TRUE(absl::IsInvalidArgument(FoldArchive(archive, fine).status()));
}

TEST(FoldTest, ScansFromBeyondTheKnotsAreRefused) {
  auto scan = std::make_shared<PosedScan>(*RandomScans(1, 13)[0]);
  for (FixedPose2& pose : scan->robot_T_sensor) pose.x = FixedPose2::kMaxUnits;
  EXPECT_TRUE(absl::IsInvalidArgument(FoldArchive(ArchiveOf({scan}), {}).status()));
  ScanArchive shortened = ArchiveOf({scan});
  Shorten(shortened, 0, {});
  EXPECT_EQ(shortened.num_scans(), 0);
  EXPECT_EQ(shortened.base.tiles.size(), 0u);
}

TEST(FoldTest, OfAnotherFoldOnlyWhatDiffersHasANewRevision) {
  const ScanArchive archive = ArchiveOf(RandomScans(100, 12));
  LayerSnapshot layer{{"robot", 1}, {1, 1}, 100, FoldOf(archive), {}};
  int n = 0;
  const auto fewer =
      std::make_shared<ScanArchive>(archive.Filtered([&](const ScanPose&) { return ++n != 100; }));
  const auto refolded = Refolded(layer, fewer, {}, {2, 1});
  ASSERT_TRUE(refolded.ok());
  const std::vector<TileKey> different = DifferentTiles(layer.tiles, refolded->tiles);
  EXPECT_FALSE(different.empty());
  EXPECT_LT(different.size(), refolded->tiles.size());
  refolded->tiles.ForEach([&](TileKey key, const TileTree::Entry& entry) {
    const bool differs = std::find(different.begin(), different.end(), key) != different.end();
    EXPECT_EQ(entry.revision, differs ? 101 : layer.tiles.RevisionOf(key));
  });
}

}  // namespace splinemap::scan_archive_test
