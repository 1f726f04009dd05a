#include "lib/sensing/scan_queue.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <random>
#include <tuple>
#include <vector>

namespace splinemap::scan_queue_test {

using std::chrono::milliseconds;
using std::chrono::seconds;

// Messages in milliseconds; the robot moves along x at 1 m/s, so a pose tells its time.
class ScanQueueTest : public testing::Test {
 protected:
  void Pose(int64_t ms) {
    queue_.AddPose({milliseconds(ms), {{static_cast<double>(ms) * 1e-3, 0}, 0}});
    Collect();
  }

  // `beam_ms`: times of the beams after the scan's.
  void ScanAt(int64_t ms, int channel = 0, std::vector<int64_t> beam_ms = {0}) {
    Scan scan;
    scan.channel = channel;
    scan.utime = milliseconds(ms);
    for (const int64_t offset : beam_ms) {
      const Utime time_offset = milliseconds(offset);
      scan.first_beam = std::min(scan.first_beam, time_offset);
      scan.last_beam = std::max(scan.last_beam, time_offset);
      scan.beams.push_back({2, 0, time_offset, true});
    }
    queue_.AddScan(std::move(scan));
    Collect();
  }

  void Flush() {
    queue_.Flush();
    Collect();
  }

  // What came out: utime in ms and channel.
  std::vector<std::pair<int64_t, int>> Placed() const {
    std::vector<std::pair<int64_t, int>> placed;
    for (const PlacedScan& scan : placed_)
      placed.emplace_back(scan.utime.count() / 1000, scan.channel);
    return placed;
  }

  int64_t Dropped(DropReason reason) const { return queue_.counts().drops[reason]; }

  void Collect() {
    while (const auto scan = queue_.Next()) Place(*scan, {}, placed_.emplace_back());
  }

  using Expected = std::vector<std::pair<int64_t, int>>;

  ScanQueue queue_{ScanQueueOptions{}, 1};
  std::vector<PlacedScan> placed_;
};

TEST_F(ScanQueueTest, AScanWaitsForAPoseAtOrAfterIt) {
  Pose(0);
  ScanAt(50);
  EXPECT_TRUE(placed_.empty());
  Pose(40);
  EXPECT_TRUE(placed_.empty());
  Pose(60);
  ASSERT_EQ(Placed(), (Expected{{50, 0}}));
  EXPECT_NEAR(placed_[0].beams[0].origin_world_m.x(), 0.05, 1e-6);
}

TEST_F(ScanQueueTest, APoseOfTheSameTimeIsEnough) {
  ScanAt(50);
  Pose(50);
  EXPECT_EQ(Placed(), (Expected{{50, 0}}));
}

TEST_F(ScanQueueTest, EachBeamGetsThePoseOfItsOwnTime) {
  Pose(0);
  Pose(200);
  ScanAt(100, 0, {-50, 0, 100});
  ASSERT_EQ(placed_.size(), 1u);
  EXPECT_NEAR(placed_[0].beams[0].origin_world_m.x(), 0.05, 1e-6);
  EXPECT_NEAR(placed_[0].beams[1].origin_world_m.x(), 0.10, 1e-6);
  EXPECT_NEAR(placed_[0].beams[2].origin_world_m.x(), 0.20, 1e-6);
}

TEST_F(ScanQueueTest, WaitsUntilTheLastBeamIsBracketed) {
  Pose(0);
  ScanAt(100, 0, {0, 100});
  Pose(150);
  EXPECT_TRUE(placed_.empty());
  Pose(200);
  EXPECT_EQ(placed_.size(), 1u);
}

TEST_F(ScanQueueTest, ExtrinsicsTurnWithTheRobot) {
  queue_.AddPose({milliseconds(0), {{1, 1}, M_PI / 2}});
  Scan scan;
  scan.robot_T_sensor = {{0.3, 0}, M_PI / 2};
  scan.beams.push_back({2, 0, Utime(0), true});
  queue_.AddScan(scan);
  Collect();
  ASSERT_EQ(placed_.size(), 1u);
  const PlacedBeam& beam = placed_[0].beams[0];
  EXPECT_NEAR(beam.origin_world_m.x(), 1, 1e-6);
  EXPECT_NEAR(beam.origin_world_m.y(), 1.3, 1e-6);
  EXPECT_NEAR(beam.direction_world.x(), -1, 1e-6);
}

TEST_F(ScanQueueTest, ScansComeOutInOrderOfTime) {
  Pose(0);
  ScanAt(300);
  ScanAt(100);
  ScanAt(200);
  Pose(400);
  EXPECT_EQ(Placed(), (Expected{{100, 0}, {200, 0}, {300, 0}}));
}

TEST_F(ScanQueueTest, ARepeatedTimeStampIsADuplicate) {
  Pose(0);
  ScanAt(50);
  ScanAt(50);
  Pose(100);
  ScanAt(50);
  EXPECT_EQ(Placed(), (Expected{{50, 0}}));
  EXPECT_EQ(Dropped(DropReason::kDuplicateScan), 2);
}

TEST_F(ScanQueueTest, ARepeatedPoseIsCountedAndIgnored) {
  Pose(0);
  queue_.AddPose({milliseconds(0), {{99, 0}, 0}});
  Pose(100);
  ScanAt(50);
  EXPECT_NEAR(placed_[0].beams[0].origin_world_m.x(), 0.05, 1e-6);
  EXPECT_EQ(Dropped(DropReason::kDuplicatePose), 1);
}

TEST_F(ScanQueueTest, AScanOlderThanOneThatIsMappedIsLate) {
  Pose(0);
  Pose(500);
  ScanAt(300);
  ScanAt(200);
  EXPECT_EQ(Placed(), (Expected{{300, 0}}));
  EXPECT_EQ(Dropped(DropReason::kLateScan), 1);
}

TEST_F(ScanQueueTest, AScanBeforeTheFirstPoseIsDropped) {
  ScanAt(10);
  Pose(50);
  Pose(100);
  EXPECT_TRUE(placed_.empty());
  EXPECT_EQ(Dropped(DropReason::kScanWithoutPose), 1);
}

TEST_F(ScanQueueTest, AScanThatPosesNeverReachIsDroppedByMessageTime) {
  Pose(0);
  ScanAt(100);
  ScanAt(2000);
  EXPECT_EQ(queue_.size(), 2u);
  ScanAt(2100);
  EXPECT_EQ(Dropped(DropReason::kScanWithoutPose), 1);
  EXPECT_EQ(queue_.size(), 2u);
}

TEST_F(ScanQueueTest, PosesInAnotherClockPlaceNothingAndFillNothing) {
  constexpr int64_t kYears = int64_t{10} * 365 * 86'400'000;
  for (int ms = 0; ms < 60'000; ms += 100) {
    ScanAt(kYears + ms);
    Pose(ms);
  }
  EXPECT_TRUE(placed_.empty());
  EXPECT_LE(queue_.size(), 21u);
  EXPECT_GE(Dropped(DropReason::kScanWithoutPose), 570);
}

TEST_F(ScanQueueTest, PosesFarApartAreNotInterpolated) {
  Pose(0);
  ScanAt(500);
  Pose(1001);
  EXPECT_TRUE(placed_.empty());
  EXPECT_EQ(Dropped(DropReason::kScanInPoseGap), 1);
  ScanAt(1500);
  Pose(2001);
  EXPECT_EQ(Placed(), (Expected{{1500, 0}}));
}

TEST_F(ScanQueueTest, TheEndOfInputMapsWhatCanBePlaced) {
  Pose(0);
  Pose(100);
  ScanAt(100);
  ScanAt(150);
  Flush();
  EXPECT_EQ(Placed(), (Expected{{100, 0}}));
  EXPECT_EQ(Dropped(DropReason::kScanWithoutPose), 1);
  EXPECT_EQ(queue_.size(), 0u);
}

TEST_F(ScanQueueTest, ALogThatIsRewoundIsMappedAgain) {
  const auto play = [&] {
    for (int ms = 5000; ms <= 9000; ms += 100) {
      Pose(ms);
      ScanAt(ms + 50);
    }
  };
  play();
  const size_t once = placed_.size();
  EXPECT_EQ(once, 40u);  // the last scan has no later pose yet
  play();
  EXPECT_EQ(placed_.size(), 2 * once);
  EXPECT_EQ(queue_.counts().time_jumps, 1);
  EXPECT_EQ(Dropped(DropReason::kLateScan), 0);
  EXPECT_EQ(Dropped(DropReason::kDuplicateScan), 0);
}

TEST_F(ScanQueueTest, TheScanChannelMayBeTheFirstToJumpBack) {
  Pose(9000);
  Pose(9100);
  ScanAt(9050);
  ScanAt(5050);
  Pose(5000);
  Pose(5100);
  EXPECT_EQ(Placed(), (Expected{{9050, 0}, {5050, 0}}));
  EXPECT_EQ(queue_.counts().time_jumps, 1);
}

TEST_F(ScanQueueTest, AJumpForwardGoesOnAtTheNewTime) {
  Pose(0);
  Pose(100);
  ScanAt(150);
  ScanAt(60'050);
  Pose(60'000);
  Pose(60'100);
  EXPECT_EQ(Placed(), (Expected{{60'050, 0}}));
  EXPECT_EQ(Dropped(DropReason::kScanWithoutPose) + Dropped(DropReason::kScanInPoseGap), 1);
}

TEST_F(ScanQueueTest, OneStampFarInTheFutureCostsAMomentAndNotTheMap) {
  for (int ms = 0; ms < 10'000; ms += 100) {
    if (ms == 5000) ScanAt(int64_t{1} << 40);
    if (ms == 7000) Pose(int64_t{1} << 40);
    Pose(ms);
    ScanAt(ms + 50);
  }
  EXPECT_GE(placed_.size(), 94u);
}

TEST_F(ScanQueueTest, OneStampOfLongAgoCostsThatMessageAlone) {
  for (int ms = 20'000; ms <= 30'000; ms += 100) {
    Pose(ms);
    if (ms == 25'000) ScanAt(1000);
    if (ms == 27'000) Pose(1000);
    if (ms == 28'000) Pose(26'500);  // though poses are kept as long
    ScanAt(ms + 50);
  }
  EXPECT_EQ(placed_.size(), 100u);  // the last scan has no later pose yet
  EXPECT_EQ(queue_.size(), 1u);
  EXPECT_EQ(queue_.counts().time_jumps, 0);
  EXPECT_EQ(Dropped(DropReason::kLateScan), 1);
  EXPECT_EQ(Dropped(DropReason::kDuplicatePose), 2);
  EXPECT_EQ(queue_.counts().drops.Total(), 3);
}

TEST_F(ScanQueueTest, AStampOfLongAgoThatComesTwiceIsNoJumpEither) {
  Pose(20'000);
  ScanAt(20'050);
  for (int n = 0; n < 3; ++n) ScanAt(1000);
  EXPECT_EQ(queue_.size(), 2u) << "one waits, one is held";
  Pose(20'100);
  ScanAt(20'150);
  EXPECT_EQ(Placed(), (Expected{{20'050, 0}}));
  EXPECT_EQ(queue_.counts().time_jumps, 0);
  EXPECT_EQ(Dropped(DropReason::kLateScan), 3);
}

TEST_F(ScanQueueTest, TwoSendersInTwoClocksLeaveTheLaterOne) {
  for (int ms = 20'000; ms <= 21'000; ms += 100) {
    Pose(ms);
    ScanAt(ms + 50);
    ScanAt(ms - 15'000);
  }
  EXPECT_EQ(placed_.size(), 10u);
  EXPECT_EQ(queue_.counts().time_jumps, 0);
}

TEST_F(ScanQueueTest, WhatIsHeldAtTheEndIsDropped) {
  Pose(20'000);
  ScanAt(20'000);
  ScanAt(1000);
  Pose(1000);
  Flush();
  EXPECT_EQ(Placed(), (Expected{{20'000, 0}}));
  EXPECT_EQ(queue_.size(), 0u);
  EXPECT_EQ(Dropped(DropReason::kLateScan), 1);
  EXPECT_EQ(Dropped(DropReason::kDuplicatePose), 1);
}

TEST_F(ScanQueueTest, MemoryIsBoundedWithoutPoses) {
  for (int64_t n = 0; n < 12'000; ++n) {
    Scan scan;
    scan.utime = Utime(n);  // within max_pose_wait of each other
    scan.beams.resize(1);
    queue_.AddScan(std::move(scan));
  }
  EXPECT_EQ(queue_.size(), ScanQueue::kMaxScans);
  EXPECT_EQ(Dropped(DropReason::kScanQueueFull), 2000);
}

class TwoScannersTest : public ScanQueueTest {
 protected:
  TwoScannersTest() { queue_ = ScanQueue(ScanQueueOptions{}, 2); }
};

TEST_F(TwoScannersTest, AScanWaitsForTheOtherScannerToReachItsTime) {
  Pose(0);
  Pose(100);
  ScanAt(60, 1);
  EXPECT_TRUE(placed_.empty());
  ScanAt(50, 0);
  EXPECT_EQ(Placed(), (Expected{{50, 0}}));
  ScanAt(70, 0);
  EXPECT_EQ(Placed(), (Expected{{50, 0}, {60, 1}}));
}

TEST_F(TwoScannersTest, ASilentScannerDelaysOnlyByTheOrderWait) {
  Pose(0);
  ScanAt(50, 0);
  Pose(249);
  EXPECT_TRUE(placed_.empty());
  Pose(250);
  EXPECT_EQ(Placed(), (Expected{{50, 0}}));
}

TEST_F(TwoScannersTest, EqualTimesComeOutByChannel) {
  Pose(0);
  Pose(100);
  ScanAt(50, 1);
  ScanAt(50, 0);
  Flush();
  EXPECT_EQ(Placed(), (Expected{{50, 0}, {50, 1}}));
}

// Messages of three channels, each in its own order, interleaved at random within the order wait:
// what comes out is the same.
TEST(ScanQueueLawTest, TheInterleavingOfChannelsDoesNotMatter) {
  struct Event {
    int64_t ms;
    int channel;  // 2: pose
  };
  using Place = std::tuple<Utime, int, double, double>;
  std::vector<Event> events;
  for (int64_t ms = 0; ms < 20'000; ms += 10) events.push_back({ms, 2});
  for (int64_t ms = 33; ms < 20'000; ms += 100) events.push_back({ms, 0});
  for (int64_t ms = 51; ms < 20'000; ms += 70) events.push_back({ms, 1});

  std::mt19937_64 random(1);
  std::vector<Place> expected;
  for (int round = 0; round < 20; ++round) {
    // Each channel is late by an amount of its own that changes slowly: its order stays.
    std::vector<std::pair<double, Event>> arrivals;
    const double phase = static_cast<double>(random() % 1000);
    for (const Event& event : events) {
      const double t = static_cast<double>(event.ms);
      const double delay = 45 * (1 + std::sin(t / (300 + 100 * event.channel) + phase));
      arrivals.emplace_back(t + delay, event);
    }
    std::stable_sort(arrivals.begin(), arrivals.end(),
                     [](const auto& a, const auto& b) { return a.first < b.first; });
    ScanQueue queue({}, 2);
    std::vector<Place> placed;
    const auto collect = [&] {
      while (const auto scan = queue.Next()) {
        PlacedScan in_map;
        splinemap::Place(*scan, {}, in_map);
        const Eigen::Vector2d& origin = in_map.beams[0].origin_world_m;
        placed.push_back({scan->utime, scan->channel, origin.x(), origin.y()});
      }
    };
    for (const auto& [arrival, event] : arrivals) {
      if (event.channel == 2) {
        const double angle = static_cast<double>(event.ms) * 1e-3;
        queue.AddPose({milliseconds(event.ms), {{std::cos(angle), std::sin(2 * angle)}, angle}});
      } else {
        Scan scan;
        scan.channel = event.channel;
        scan.utime = milliseconds(event.ms);
        scan.robot_T_sensor = {{0.1 * event.channel, 0.2}, 0};
        scan.beams.resize(1);
        queue.AddScan(scan);
      }
      collect();
    }
    queue.Flush();
    collect();
    if (round == 0) expected = placed;
    EXPECT_GT(placed.size(), 480u);
    EXPECT_EQ(placed, expected) << "round " << round;
  }
}

TEST_F(ScanQueueTest, ScansInAJumpOfPosesAreLeftOut) {
  // One pose is off, by 1 km, at the time of a scan and between scans.
  for (int64_t ms = 0; ms <= 1000; ms += 100) {
    if (ms == 500) {
      queue_.AddPose({milliseconds(ms), {{1000, 0}, 0}});
    } else {
      Pose(ms);
    }
    ScanAt(ms);
    if (ms >= 100) ScanAt(ms - 50);
  }
  Pose(1100);
  EXPECT_EQ(Dropped(DropReason::kScanInPoseJump), 3) << "at 450, 500 and 550 ms";
  EXPECT_EQ(queue_.counts().pose_jumps, 2);
  for (const PlacedScan& scan : placed_) EXPECT_LT(scan.map_T_robot.position_m.x(), 2);
}

TEST_F(ScanQueueTest, ACorrectionOfTheLocalisationCostsTheScanBetweenAlone) {
  for (int64_t ms = 0; ms < 500; ms += 100) Pose(ms);
  for (int64_t ms = 500; ms <= 1000; ms += 100) {
    queue_.AddPose({milliseconds(ms), {{50, 0}, 0}});
  }
  for (const int64_t ms : {400, 450, 500, 550}) ScanAt(ms);
  EXPECT_EQ(Dropped(DropReason::kScanInPoseJump), 1);
  EXPECT_EQ(placed_.size(), 3u);
}

TEST_F(ScanQueueTest, ScansOfATiltedRobotAreLeftOut) {
  TimedPose tilted{milliseconds(1000), {{1, 0}, 0}};
  tilted.up_robot = {std::sin(0.35), 0, std::cos(0.35)};
  Pose(0);
  queue_.AddPose(tilted);
  Pose(2000);
  for (const int64_t ms : {100, 1000, 1900}) ScanAt(ms);
  EXPECT_EQ(Dropped(DropReason::kTiltedScan), 1);
  EXPECT_EQ(placed_.size(), 2u);
}

}  // namespace splinemap::scan_queue_test
