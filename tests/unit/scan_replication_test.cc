// Copies of a layer that go on by folding the scans that its owner sends.
#include <gtest/gtest.h>

#include "tests/support/replication_world.h"

namespace splinemap::replication_test {

void Drive(World& world, int scans, int half_width = 5) {
  for (int n = 0; n < scans; ++n) {
    world.Commit(half_width);
    world.Run(milliseconds(100));
  }
}

void LoseMoreScansThanAreKept(World& world) {
  world.network().SetCut(true);
  for (int n = 0; n < 6000; ++n) world.Commit(5);
  world.Run(milliseconds(5000));
  world.network().SetCut(false);
}

TEST(ScanReplicationTest, WithoutLossScansAreEnough) {
  World world({}, {}, 1, Commits::kScans);
  for (int n = 0; n < 3; ++n) world.AddFollower();
  world.Run(milliseconds(1500));
  const int64_t bytes = world.bytes_of_owner();
  Drive(world, 200);
  world.Run(milliseconds(1500));
  EXPECT_TRUE(world.AllCaughtUp());
  EXPECT_EQ(world.tiles_sent(), 0);
  EXPECT_EQ(world.scans_sent(), 200);
  EXPECT_LE(world.bytes_of_owner() - bytes, 200 * 450);
  for (size_t n = 0; n < world.num_followers(); ++n) {
    const FollowCounts& counts = world.follower(n).counts();
    EXPECT_EQ(counts.folded, 200);
    EXPECT_EQ(counts.asked_scans + counts.asked_nodes + counts.unusable + counts.misfolded, 0);
  }
}

TEST(ScanReplicationTest, AScanIsThereInTheNextStep) {
  World world({}, {}, 2, Commits::kScans);
  world.AddFollower();
  world.Run(milliseconds(1500));
  for (int n = 0; n < 50; ++n) {
    world.Commit(3);
    world.Step();  // it is sent
    world.Step();  // it arrives
    ASSERT_TRUE(world.IsEqual(0)) << n;
  }
}

TEST(ScanReplicationTest, ALateFollowerGetsTilesAndThenScans) {
  World world({}, {}, 3, Commits::kScans);
  Drive(world, 100);
  world.AddFollower();
  Drive(world, 100);
  world.Run(milliseconds(1500));
  EXPECT_TRUE(world.AllCaughtUp());
  EXPECT_GT(world.tiles_sent(), 0);
  EXPECT_GE(world.follower(0).counts().folded, 80);
  const int64_t tiles = world.tiles_sent();
  Drive(world, 50);
  EXPECT_EQ(world.tiles_sent(), tiles);
}

TEST(ScanReplicationTest, AGapIsFilledByNumberOnceForAll) {
  World world({}, {}, 4, Commits::kScans);
  for (int n = 0; n < 16; ++n) world.AddFollower();
  world.Run(milliseconds(1500));
  Drive(world, 20);
  ASSERT_EQ(world.scans_sent(), 20);
  world.network().SetCut(true);
  Drive(world, 5);
  world.network().SetCut(false);
  Drive(world, 20);
  world.Run(milliseconds(1500));
  EXPECT_TRUE(world.AllCaughtUp());
  EXPECT_EQ(world.tiles_sent(), 0);
  EXPECT_LE(world.scans_sent(), 45 + 10);
  int64_t asked = 0;
  for (size_t n = 0; n < world.num_followers(); ++n)
    asked += world.follower(n).counts().asked_scans;
  EXPECT_LE(asked, 12) << "of 16 that lacked the same";
}

TEST(ScanReplicationTest, ADigestThatComesBeforeItsScanIsComparedWithIt) {
  World world({}, {}, 21, Commits::kScans);
  world.AddFollower();
  world.Run(milliseconds(1500));
  Drive(world, 10);
  while (!world.DigestWasSent()) world.Step();
  world.network().SetCut(true);
  world.Commit(5);
  world.Step();
  world.network().SetCut(false);
  do {
    world.Step();
  } while (!world.DigestWasSent());
  world.Run(milliseconds(400));  // and no other digest comes
  EXPECT_TRUE(world.AllCaughtUp());
  EXPECT_TRUE(world.follower(0).matches_digest());
}

TEST(ScanReplicationTest, WhatIsOlderThanTheScansOfTheOwnerComesAsTiles) {
  World world({}, {}, 5, Commits::kScans);
  world.AddFollower();
  world.Run(milliseconds(1500));
  Drive(world, 10);
  LoseMoreScansThanAreKept(world);
  const int64_t scans = world.scans_sent();
  const int64_t tiles = world.tiles_sent();
  Drive(world, 25);
  EXPECT_GT(world.tiles_sent(), tiles);  // it was told, and did not ask in vain
  Drive(world, 15);
  world.Run(milliseconds(1500));
  EXPECT_TRUE(world.AllCaughtUp());
  EXPECT_GT(world.tiles_sent(), 0);
  EXPECT_LE(world.scans_sent(), scans + 60);
}

TEST(ScanReplicationTest, ThatScansAreGoneIsToldAlsoWhenNoneComes) {
  World world({}, {}, 22, Commits::kScans);
  world.AddFollower();
  world.Run(milliseconds(1500));
  Drive(world, 10);
  LoseMoreScansThanAreKept(world);
  const int64_t tiles = world.tiles_sent();
  world.Run(milliseconds(2800));
  EXPECT_GT(world.tiles_sent(), tiles);
}

TEST(ScanReplicationTest, ScansThatTheBudgetHasNoRoomForComeAsTiles) {
  PublisherOptions options;
  options.bytes_per_s = 3000;
  World world({}, options, 6, Commits::kScans);
  world.AddFollower();
  world.Run(milliseconds(1500));
  for (int n = 0; n < 100; ++n) {
    for (int k = 0; k < 10; ++k) world.Commit(0);
    world.Run(milliseconds(100));
  }
  EXPECT_LT(world.scans_sent(), 500);
  world.Run(milliseconds(20'000));
  EXPECT_TRUE(world.AllCaughtUp());
}

// A scan in the owner's name that it never mapped.
layer_scans_t ForgedScan(World& world, uint64_t revision, Random& random) {
  const PosedScan scan = RandomScan(random, 5);
  layer_scans_t message{};
  message.speaker = world.last_digest().speaker;
  message.layer = world.last_digest().layer;
  message.oldest = 1;
  message.num_scans = 1;
  scan_record_t& record = message.scans.emplace_back();
  record.revision = static_cast<int64_t>(revision);
  record.utime = scan.utime.count();
  record.robot_x = scan.world_T_robot.x;
  record.robot_y = scan.world_T_robot.y;
  record.robot_yaw = scan.world_T_robot.yaw;
  record.num_parts = 1;
  const std::string beams = PackBeams(scan, {});
  record.content.assign(beams.begin(), beams.end());
  record.num_bytes = static_cast<int32_t>(beams.size());
  return message;
}

TEST(ScanReplicationTest, AForgedScanIsFoundByTheNextDigest) {
  World world({}, {}, 7, Commits::kScans);
  world.AddFollower();
  world.Run(milliseconds(1500));
  Drive(world, 20);
  const uint64_t next = world.OwnersLayer().revision + 1;
  world.follower(0).HandleScans(ForgedScan(world, next, world.random()), world.network().now());
  EXPECT_FALSE(world.IsEqual(0));
  Drive(world, 20);
  world.Run(milliseconds(3000));
  EXPECT_TRUE(world.AllCaughtUp());
  EXPECT_EQ(world.follower(0).counts().misfolded, 1);
  const int64_t tiles = world.tiles_sent();
  Drive(world, 20);
  world.Run(milliseconds(1500));
  EXPECT_EQ(world.tiles_sent(), tiles);  // it folds again
  EXPECT_TRUE(world.AllCaughtUp());
}

TEST(ScanReplicationTest, AForgedTileIsNotTakenByWhoFoldsScans) {
  World world({}, {}, 20, Commits::kScans);
  world.AddFollower();
  world.Run(milliseconds(1500));
  Drive(world, 20);
  world.Forge({0, 0}, world.OwnersLayer().revision + 5, 77);
  world.Forge({50, 0}, 1, 77);
  EXPECT_TRUE(world.IsEqual(0));
  Drive(world, 20);
  world.Run(milliseconds(1500));
  EXPECT_TRUE(world.AllCaughtUp());
  EXPECT_EQ(world.follower(0).counts().misfolded, 0);
}

TEST(ScanReplicationTest, AForgedScanFarAheadIsForgottenWithTheNextDigest) {
  World world({}, {}, 8, Commits::kScans);
  world.AddFollower();
  world.Run(milliseconds(1500));
  Drive(world, 20);
  const uint64_t far = world.OwnersLayer().revision + 1000;
  world.follower(0).HandleScans(ForgedScan(world, far, world.random()), world.network().now());
  Drive(world, 30);
  EXPECT_TRUE(world.AllCaughtUp());
  EXPECT_EQ(world.tiles_sent(), 0);
  EXPECT_LE(world.follower(0).counts().asked_scans, 8);
}

TEST(ScanReplicationTest, ARunOfForgedScansIsFoundThoughTheOwnerIsNotThatFar) {
  for (const bool is_part : {false, true}) {
    World world({}, {}, 14, Commits::kScans);
    world.AddFollower(
        {LevelOfDetail(), is_part ? std::optional(TileBox{-4, -4, 4, 4}) : std::nullopt});
    world.Run(milliseconds(1500));
    Drive(world, 20);
    const uint64_t revision = world.OwnersLayer().revision;
    for (uint64_t n = 1; n <= 500; ++n) {
      world.follower(0).HandleScans(ForgedScan(world, revision + n, world.random()),
                                    world.network().now());
    }
    Drive(world, 100);
    world.Run(milliseconds(3000));
    EXPECT_TRUE(world.AllCaughtUp());
  }
}

// A scanner that marches across the world in one scan touches more tiles than there is memory for.
TEST(ScanReplicationTest, AScanThatNoScannerCanMakeIsRefusedCheaply) {
  World world({}, {}, 16, Commits::kScans);
  world.AddFollower();
  world.Run(milliseconds(1500));
  Drive(world, 10);
  layer_scans_t message = ForgedScan(world, world.OwnersLayer().revision + 1, world.random());
  PosedScan scan;
  for (int k = 0; k < 1600; ++k) {
    scan.robot_T_sensor.push_back(FixedPose2::Nearest({{8.0 * k, 0}, 0}));
    scan.beams.push_back(
        {.range_m = 200, .bearing_rad = 1.5F, .hit = false, .reading = static_cast<uint16_t>(k)});
  }
  const std::string beams = PackBeams(scan, {});
  ASSERT_LT(beams.size(), 1400u);
  message.scans[0].content.assign(beams.begin(), beams.end());
  message.scans[0].num_bytes = static_cast<int32_t>(beams.size());
  world.follower(0).HandleScans(message, world.network().now());
  EXPECT_EQ(world.follower(0).counts().unusable, 1);
  Drive(world, 10);
  EXPECT_TRUE(world.AllCaughtUp());
}

// Whoever pulls scans of an owner that keeps none, or says that it has none, keeps nobody from
// tiles.
TEST(ScanReplicationTest, AnEmptyMessageOfScansChangesNothing) {
  World world({}, {}, 17, Commits::kTiles);
  world.AddFollower();
  world.Run(milliseconds(1500));
  scan_pull_t pull{};
  pull.layer = world.last_digest().layer;
  pull.num_ranges = 1;
  pull.first = {0};
  pull.last = {1000};
  world.publisher().HandleScanPull(pull, world.network().now());
  layer_scans_t empty{};
  empty.speaker = world.last_digest().speaker;
  empty.layer = world.last_digest().layer;
  empty.oldest = 1000;
  world.follower(0).HandleScans(empty, world.network().now());
  const auto asked = [&] {
    const FollowCounts& counts = world.follower(0).counts();
    return counts.asked_scans + counts.asked_tiles + counts.asked_nodes;
  };
  const int64_t before = asked();
  Drive(world, 50);
  world.Run(milliseconds(1500));
  EXPECT_TRUE(world.AllCaughtUp());
  EXPECT_EQ(asked(), before);
}

TEST(ScanReplicationTest, NothingLagsAfterTheLastScan) {
  World world({}, {}, 18, Commits::kScans);
  world.AddFollower();
  Drive(world, 30);
  world.Run(milliseconds(5000));
  EXPECT_EQ(world.last_digest().lag_s, 0);
}

// A publisher of its own, between whose calls nothing happens.
class Publisher {
 public:
  explicit Publisher(Commits commits)
      : layer_(map_.AddLayer(kId, {1, 1})),
        publisher_(commits == Commits::kScans ? mapper_.SnapshotOf(layer_) : layer_.Snapshot(),
                   kMapOptions, {}) {}

  PyramidPublisher& publisher() { return publisher_; }
  void Announce(const PosedScan& scan) {
    publisher_.AddScan(ScanMapper::SentOf(scan, layer_), now_);
  }
  void Map(const PosedScan& scan) {
    mapper_.Map(scan, layer_);
    publisher_.SetLayer(mapper_.SnapshotOf(layer_), now_);
  }
  std::vector<ReplicationMessage> TickAfter(milliseconds time) {
    return TickOf(publisher_, now_ += time);
  }

 private:
  MapWriter map_{kMapOptions};
  Layer& layer_;
  ScanMapper mapper_{Folder()};
  PyramidPublisher publisher_;
  Clock::time_point now_ = kNow;
};

template <typename Message>
int CountOf(const std::vector<ReplicationMessage>& messages) {
  return static_cast<int>(std::count_if(messages.begin(), messages.end(), [](const auto& message) {
    return std::holds_alternative<Message>(message);
  }));
}

TEST(ScanReplicationTest, FewMessagesGoAtOnce) {
  Publisher owner(Commits::kScans);
  owner.TickAfter(milliseconds(0));
  Random random(1);
  for (int n = 0; n < 200; ++n) {
    const PosedScan scan = RandomScan(random, 5);
    owner.Announce(scan);
    owner.Map(scan);
  }
  const int at_once = CountOf<layer_scans_t>(owner.TickAfter(milliseconds(10)));
  EXPECT_GT(at_once, 5);
  EXPECT_LE(at_once, 12);
  EXPECT_EQ(owner.TickAfter(milliseconds(1)).size(), 0u);
  EXPECT_GT(CountOf<layer_scans_t>(owner.TickAfter(milliseconds(1))), 5);
}

TEST(ScanReplicationTest, ADigestWaitsForTheLayerThatHasTheScansBeforeIt) {
  Publisher owner(Commits::kScans);
  EXPECT_EQ(CountOf<layer_digest_t>(owner.TickAfter(milliseconds(0))), 1);
  Random random(1);
  const PosedScan scan = RandomScan(random, 5);
  owner.Announce(scan);
  const auto before = owner.TickAfter(milliseconds(1000));
  EXPECT_EQ(CountOf<layer_scans_t>(before), 1);
  EXPECT_EQ(CountOf<layer_digest_t>(before), 0);
  owner.Map(scan);
  EXPECT_EQ(CountOf<layer_digest_t>(owner.TickAfter(milliseconds(1))), 1);
}

TEST(ScanReplicationTest, AnOwnerWithoutScansDoesNotAnswerForThem) {
  scan_pull_t pull{};
  pull.layer = ToMessage(LayerRef{kId, {1, 1}, {}});
  pull.num_ranges = 1;
  pull.first = {0};
  pull.last = {0};
  for (const Commits commits : {Commits::kTiles, Commits::kScans}) {
    Publisher owner(commits);
    owner.TickAfter(milliseconds(0));
    owner.publisher().HandleScanPull(pull, kNow);
    EXPECT_EQ(CountOf<layer_scans_t>(owner.TickAfter(milliseconds(1))),
              commits == Commits::kScans ? 1 : 0);
  }
}

TEST(ScanReplicationTest, RecordsThatAreDamagedAreAskedForAgain) {
  World world({}, {}, 9, Commits::kScans);
  world.AddFollower();
  world.Run(milliseconds(1500));
  Drive(world, 10);
  layer_scans_t message = ForgedScan(world, world.OwnersLayer().revision + 1, world.random());
  message.scans[0].content.resize(message.scans[0].content.size() / 2);
  message.scans[0].num_bytes = static_cast<int32_t>(message.scans[0].content.size());
  world.follower(0).HandleScans(message, world.network().now());
  EXPECT_EQ(world.follower(0).counts().unusable, 1);
  Drive(world, 20);
  EXPECT_TRUE(world.AllCaughtUp());
  EXPECT_EQ(world.tiles_sent(), 0);
}

// Another kind of processor rounds otherwise: what comes of it is never the owner's.
TEST(ScanReplicationTest, WhoseFoldsAreNotTheOwnersTakesTiles) {
  World world({}, {}, 10, Commits::kScans);
  world.AddFollower();
  world.Run(milliseconds(1500));
  for (int n = 0; n < 100; ++n) {
    if (n % 5 == 0) {
      world.follower(0).HandleScans(
          ForgedScan(world, world.OwnersLayer().revision + 1, world.random()),
          world.network().now());
    }
    world.Commit(3);
    world.Run(milliseconds(100));
  }
  EXPECT_EQ(world.follower(0).counts().misfolded, 3);
  world.Run(milliseconds(1500));
  EXPECT_TRUE(world.AllCaughtUp());
  // Pushed, since it asked for that.
  const int64_t tiles = world.tiles_sent();
  const int64_t asked = world.follower(0).counts().asked_tiles;
  Drive(world, 50);
  world.Run(milliseconds(1500));
  EXPECT_GT(world.tiles_sent(), tiles);
  EXPECT_EQ(world.follower(0).counts().asked_tiles, asked);
  EXPECT_TRUE(world.AllCaughtUp());
  // Some time later it tries again.
  world.Run(milliseconds(60'000));
  const int64_t folded = world.follower(0).counts().folded;
  Drive(world, 20);
  EXPECT_GT(world.follower(0).counts().folded, folded);
}

TEST(ScanReplicationTest, TilesArePushedWhileAFollowerAsksForThem) {
  World world({}, {}, 11, Commits::kScans);
  world.AddFollower();
  world.Run(milliseconds(1500));
  world.AddFollower({}, nullptr);
  Drive(world, 100);
  world.Run(milliseconds(1500));
  EXPECT_TRUE(world.AllCaughtUp());
  const int64_t asked = world.follower(1).counts().asked_tiles;
  Drive(world, 100);
  world.Run(milliseconds(1500));
  EXPECT_TRUE(world.AllCaughtUp());
  EXPECT_EQ(world.follower(1).counts().asked_tiles, asked);
  EXPECT_EQ(world.follower(1).counts().folded, 0);
  EXPECT_EQ(world.follower(0).counts().applied, 0);
  world.RemoveFollowers();
  world.Run(milliseconds(31'000));
  const int64_t tiles = world.tiles_sent();
  Drive(world, 20);
  EXPECT_EQ(world.tiles_sent(), tiles);
}

TEST(ScanReplicationTest, APartFoldsWhatTouchesIt) {
  World world({}, {}, 12, Commits::kScans);
  TileBox box;
  box.Add({-3, -3});
  box.Add({2, 2});
  world.AddFollower({LevelOfDetail(), box});
  world.Run(milliseconds(1500));
  Drive(world, 200, 20);
  world.Run(milliseconds(3000));
  EXPECT_TRUE(world.AllCaughtUp());
  EXPECT_EQ(world.tiles_sent(), 0);
  EXPECT_EQ(world.follower(0).counts().folded, 200);
  EXPECT_EQ(world.follower(0).counts().misfolded, 0);
}

TEST(ScanReplicationTest, FollowersOnAllKindsOfProcessorsHaveTheSameBytes) {
  World world({.loss = 0.1}, {}, 15, Commits::kScans);
  for (const ScanKernel& kernel : ScanKernels()) {
    world.AddFollower({}, std::make_shared<ScanFolder>(kMapOptions, kernel));
  }
  world.Run(milliseconds(1500));
  Drive(world, 500, 20);
  world.Run(milliseconds(3000));
  EXPECT_TRUE(world.AllCaughtUp());
  EXPECT_EQ(world.tiles_sent(), 0);
  for (size_t n = 0; n < world.num_followers(); ++n) {
    EXPECT_GE(world.follower(n).counts().folded, 500);
    EXPECT_EQ(world.follower(n).counts().misfolded, 0);
  }
}

TEST(ScanReplicationTest, ALongScanGoesInParts) {
  World world({.loss = 0.1}, {}, 13, Commits::kScans);
  world.AddFollower();
  world.Run(milliseconds(1500));
  for (int n = 0; n < 20; ++n) {
    PosedScan scan = RandomScan(world.random(), 5);
    const std::vector<Beam> few = scan.beams;
    for (int k = 0; k < 2000; ++k) {
      Beam beam = few[k % few.size()];
      beam.reading = static_cast<uint16_t>(24 + k);
      beam.bearing_rad = static_cast<float>(0.003 * k);
      beam.range_m += static_cast<float>(1e-4 * double(world.random()() % 1000));
      scan.beams.push_back(beam);
    }
    scan.robot_T_sensor.resize(1);
    world.Map(scan);
    world.Run(milliseconds(100));
  }
  world.Run(milliseconds(3000));
  EXPECT_TRUE(world.AllCaughtUp());
  EXPECT_EQ(world.tiles_sent(), 0);
}

}  // namespace splinemap::replication_test
