#include "services/splinemapd/daemon.h"

#include <gtest/gtest.h>

#include <cmath>
#include <filesystem>
#include <fstream>
#include <numbers>
#include <thread>

#include "lcmtypes/bot_core/rigid_transform_t.hpp"
#include "lcmtypes/splinemap/layer_settings_t.hpp"
#include "lcmtypes/splinemap/layers_t.hpp"
#include "lcmtypes/splinemap/settings_t.hpp"
#include "lcmtypes/splinemap/status_t.hpp"
#include "lcmtypes/splinemap/trajectory_t.hpp"
#include "lib/mapping/fold.h"
#include "lib/replication/protocol.h"
#include "lib/wire/decode.h"
#include "lib/wire/encode.h"
#include "splinemap/file.h"
#include "tests/support/map_writer.h"
#include "tests/support/temporary_directory.h"

namespace splinemap::daemon_test {

using std::chrono::milliseconds;
using std::chrono::steady_clock;

// A daemon on a bus inside this process.
class DaemonTest : public testing::Test {
 protected:
  DaemonTest() {
    config_.set_name("robot");
    config_.set_map(directory_.File("robot.splinemap"));
    config_.set_pose("POSE");
    config_.add_scan()->set_channel("LASER");
    config_.mutable_service()->set_save_interval_s(0.1);
  }

  void Start() {
    auto bus = LcmBus::Open("memq://");
    ASSERT_TRUE(bus.ok()) << bus.status();
    bus_ = bus->get();
    bus_->Subscribe("SPLINEMAP_STATUS", [this](const std::string&, absl::Span<const uint8_t> m) {
      MutexLock lock(mutex_);
      statuses_.push_back(*Decode<status_t>(m));
    });
    bus_->Subscribe("SPLINEMAP_LAYERS", [this](const std::string&, absl::Span<const uint8_t> m) {
      MutexLock lock(mutex_);
      lists_.push_back(*Decode<layers_t>(m));
    });
    auto daemon = Daemon::Start(config_, *std::move(bus));
    ASSERT_TRUE(daemon.ok()) << daemon.status();
    daemon_ = *std::move(daemon);
  }

  // A robot that drives a circle in a round room of 3 m.
  // Its localisation drifts along x by `drift_m` a scan.
  void Drive(int scans, int64_t first_ms = 0, double drift_m = 0) {
    DriveFrom(0, scans, first_ms, drift_m);
  }
  // The part of it from scan `first` on.
  void DriveFrom(int first, int scans, int64_t first_ms = 0, double drift_m = 0) {
    for (int n = first; n < first + scans; ++n) {
      const Utime utime = milliseconds(first_ms + 100 * n);
      const double angle = 0.1 * n;
      const Pose2 pose{{std::cos(angle), std::sin(angle)}, angle};
      Pose2 said = pose;
      said.position_m.x() += drift_m * n;
      bus_->Publish("POSE", PoseMessage({utime, said}));
      std::vector<float> ranges_m;
      for (int k = 0; k < 90; ++k) {
        const double bearing = angle + k * 2 * std::numbers::pi / 90;
        const double along =
            pose.position_m.x() * std::cos(bearing) + pose.position_m.y() * std::sin(bearing);
        ranges_m.push_back(static_cast<float>(std::sqrt(along * along + 8) - along));
      }
      bus_->Publish("LASER",
                    PlanarLidarMessage(utime, std::move(ranges_m), 0, 2 * std::numbers::pi / 90));
    }
  }

  // The right poses of Drive(), in parts.
  void PublishTrajectory(int scans, int64_t first_ms = 0) {
    constexpr int kPosesInPart = 50;
    const int parts = (scans + kPosesInPart - 1) / kPosesInPart;
    for (int part = parts - 1; part >= 0; --part) {
      trajectory_t message{};
      message.utime = std::chrono::microseconds(milliseconds(first_ms + 100 * scans)).count();
      message.robot = "robot";
      message.part = part;
      message.num_parts = parts;
      for (int n = kPosesInPart * part; n < std::min(scans, kPosesInPart * (part + 1)); ++n) {
        const double angle = 0.1 * n;
        message.pose_utime.push_back(1000 * (first_ms + 100 * n));
        message.x_m.push_back(std::cos(angle));
        message.y_m.push_back(std::sin(angle));
        message.yaw_rad.push_back(angle);
      }
      message.num_poses = static_cast<int>(message.pose_utime.size());
      bus_->Publish("SPLINEMAP_TRAJECTORY", message);
    }
  }

  // The tiles of a daemon that did `work` and nothing else.
  template <typename Work>
  TileTree TilesAfter(const Work& work) {
    config_.set_map(directory_.File("other.splinemap"));
    Start();
    work();
    EXPECT_TRUE(daemon_->Stop().ok());
    const TileTree tiles = SavedMap()->layers[0].tiles;
    daemon_.reset();
    std::filesystem::remove(config_.map());
    config_.set_map(directory_.File("robot.splinemap"));
    return tiles;
  }

  // Waits until the layer on disk was made anew.
  void AwaitSession(uint64_t number) {
    AwaitStatus([&](const status_t& status) {
      return status.session_number == static_cast<int64_t>(number);
    });
  }

  // Stops, and compares what is on disk, and what its scans make, with these tiles.
  void ExpectTiles(const TileTree& expected) {
    ASSERT_TRUE(daemon_->Stop().ok());
    const LayerSet saved = *SavedMap();
    EXPECT_EQ(DifferentTiles(saved.layers[0].tiles, expected).size(), 0u);
    const auto folded = FoldArchive(*saved.layers[0].archive, saved.options);
    ASSERT_TRUE(folded.ok()) << folded.status();
    EXPECT_EQ(DifferentTiles(saved.layers[0].tiles, *folded).size(), 0u);
  }

  // As anybody on the bus may do it.
  void PublishRemoval() {
    const LayerId id = SavedMap()->layers[0].id;
    settings_t records{};
    records.speaker = 99;
    records.hash = 1;
    records.num_layers = 1;
    layer_settings_t& record = records.layers.emplace_back();
    record = {};
    record.name = id.name;
    record.origin = static_cast<int64_t>(id.origin);
    record.counter = 1;
    record.removed_up_to = (1 << 20) - 1;
    bus_->Publish("SPLINEMAP_SETTINGS", records);
  }

  // The newest status that `is_right`, waiting for it up to ten seconds.
  template <typename Condition>
  status_t AwaitStatus(Condition is_right) {
    const auto deadline = steady_clock::now() + std::chrono::seconds(10);
    while (steady_clock::now() < deadline) {
      daemon_->PublishStatus();
      std::this_thread::sleep_for(milliseconds(20));
      MutexLock lock(mutex_);
      if (!statuses_.empty() && is_right(statuses_.back())) return statuses_.back();
    }
    ADD_FAILURE() << "no such status within ten seconds";
    return {};
  }

  std::optional<LayerSet> SavedMap() const {
    const auto loaded = ReadMapFile(config_.map());
    EXPECT_TRUE(loaded.ok()) << loaded.status();
    return loaded.ok() ? std::optional(loaded->set) : std::nullopt;
  }

  TemporaryDirectory directory_;
  config::Config config_;
  Mutex mutex_;
  std::vector<status_t> statuses_ ABSL_GUARDED_BY(mutex_);
  std::vector<layers_t> lists_ ABSL_GUARDED_BY(mutex_);
  LcmBus* bus_ = nullptr;
  std::unique_ptr<Daemon> daemon_;
};

TEST_F(DaemonTest, MapsAndSaysWhatItDid) {
  Start();
  Drive(50);
  bus_->Publish("LASER", PoseMessage({Utime(0), {}}));  // a message of the wrong type
  const status_t status = AwaitStatus([](const status_t& s) { return s.messages_received == 101; });
  EXPECT_EQ(status.name, "robot");
  EXPECT_EQ(status.session_number, 1);
  EXPECT_EQ(status.scans_received, 51);
  EXPECT_EQ(status.poses_received, 50);
  EXPECT_EQ(status.scans_mapped, 50);
  EXPECT_EQ(status.revision, 50);
  EXPECT_EQ(status.newest_scan_utime, 4'900'000);
  EXPECT_GE(status.newest_scan_age_s, 0);
  EXPECT_GT(status.tiles, 0);
  ASSERT_EQ(status.num_drop_reasons, 1);
  EXPECT_EQ(status.drop_reasons[0], "wrong_type_of_scan");
  EXPECT_EQ(status.messages_dropped, 1);
  EXPECT_NE(status.last_problem, "");
}

TEST_F(DaemonTest, ADaemonWithoutNewsSaysNothingUnlessItIsAsked) {
  Start();
  Drive(20);
  AwaitStatus([](const status_t& s) { return s.saved_revision == 20; });
  const auto publish = [&] {
    for (int n = 0; n < 10; ++n) {
      daemon_->PublishStatus();
      std::this_thread::sleep_for(milliseconds(20));
    }
    MutexLock lock(mutex_);
    return std::pair(std::exchange(statuses_, {}), std::exchange(lists_, {}));
  };
  publish();
  const auto [no_statuses, no_lists] = publish();
  EXPECT_EQ(no_statuses.size(), 0u);
  EXPECT_EQ(no_lists.size(), 0u);
  bus_->Publish("SPLINEMAP_PULLS", MakeCall(7));
  std::this_thread::sleep_for(milliseconds(500));
  const auto [statuses, lists] = publish();
  ASSERT_EQ(statuses.size(), 1u);
  EXPECT_EQ(statuses[0].revision, 20);
  ASSERT_EQ(lists.size(), 1u);
  ASSERT_EQ(lists[0].num_layers, 1);
  EXPECT_EQ(lists[0].layers[0].state, "own");
  EXPECT_EQ(lists[0].layers[0].revision, 20);
  EXPECT_EQ(lists[0].layers[0].num_tiles, statuses[0].tiles);
  EXPECT_GT(lists[0].layers[0].x1_m - lists[0].layers[0].x0_m, 5);
  // More of the same layer is no news to those who list layers.
  Drive(20, 2000);
  AwaitStatus([](const status_t& s) { return s.scans_mapped == 40; });
  EXPECT_EQ(publish().second.size(), 0u);
}

TEST_F(DaemonTest, SavesWhileItRuns) {
  Start();
  Drive(20);
  AwaitStatus([](const status_t& s) { return s.saved_revision == 20; });
  EXPECT_EQ(SavedMap()->layers[0].revision, 20u);
  EXPECT_GT(ViewOf(*SavedMap())->Evaluate(3.03, 0).log_odds, 0);
  EXPECT_LT(ViewOf(*SavedMap())->Evaluate(0, 0).log_odds, 0);
}

TEST_F(DaemonTest, StopMapsAndSavesWhatWasReceived) {
  config_.mutable_service()->set_save_interval_s(3600);
  Start();
  Drive(200);
  ASSERT_TRUE(daemon_->Stop().ok());
  EXPECT_EQ(SavedMap()->layers[0].revision, 200u);
  EXPECT_TRUE(daemon_->Stop().ok()) << "a second time does nothing";
}

TEST_F(DaemonTest, ANewSessionIsOnDiskAtOnceAndGoesOnWithTheMap) {
  Start();
  const auto first = SavedMap();
  EXPECT_EQ(first->layers[0].session.number, 1u);
  Drive(30);
  ASSERT_TRUE(daemon_->Stop().ok());
  daemon_.reset();

  Start();
  const auto second = SavedMap();
  ASSERT_EQ(second->layers.size(), 1u);
  EXPECT_EQ(second->layers[0].id, first->layers[0].id);
  EXPECT_EQ(second->layers[0].session.number, 2u);
  EXPECT_NE(second->layers[0].session.nonce, first->layers[0].session.nonce);
  Drive(30, 100'000);
  ASSERT_TRUE(daemon_->Stop().ok());
  EXPECT_EQ(SavedMap()->layers[0].revision, 60u);
}

TEST_F(DaemonTest, AnotherNameIsAnotherLayerOfTheFile) {
  Start();
  Drive(10);
  daemon_.reset();
  const auto before = SavedMap();
  config_.set_name("other");
  Start();
  Drive(10);
  daemon_.reset();
  const auto after = SavedMap();
  ASSERT_EQ(after->layers.size(), 2u);
  EXPECT_EQ(after->layers[0].id.name, "other");  // the daemon's own comes first
  EXPECT_EQ(after->layers[1].id, before->layers[0].id);
  EXPECT_EQ(after->layers[1].revision, before->layers[0].revision);
}

TEST_F(DaemonTest, AMapOfAnotherKnotIntervalIsRefusedInWords) {
  Start();
  daemon_.reset();
  config_.mutable_method()->set_knot_interval_m(0.1);
  const auto status = Daemon::Start(config_, *LcmBus::Open("memq://")).status();
  EXPECT_TRUE(absl::IsFailedPrecondition(status));
  EXPECT_NE(std::string(status.message()).find("knot_interval_m 0.05"), std::string::npos)
      << status;
  config_.mutable_method()->clear_knot_interval_m();
  EXPECT_TRUE(Daemon::Start(config_, *LcmBus::Open("memq://")).ok()) << "unset: as the file says";
}

TEST_F(DaemonTest, ALayerThatSomebodyRemovedGoesOnEmpty) {
  Start();
  Drive(30);
  AwaitStatus([](const status_t& s) { return s.revision == 30; });
  PublishRemoval();
  const status_t status = AwaitStatus([](const status_t& s) { return s.tiles == 0; });
  EXPECT_EQ(status.session_number, int64_t{1} << 20);
  EXPECT_EQ(ViewOf(*SavedMap())->tiles.size(), 0u) << "on disk first";
  Drive(10, 100'000);
  ASSERT_TRUE(daemon_->Stop().ok());
  EXPECT_GT(ViewOf(*SavedMap())->tiles.size(), 0u);
  EXPECT_EQ(SavedMap()->layers[0].archive->num_scans(), 10) << "those before are gone, too";
}

TEST_F(DaemonTest, WithoutRemoteCommandsNoSettingIsTakenFromTheBus) {
  config_.mutable_service()->set_remote_commands(false);
  Start();
  Drive(30);
  const int64_t tiles = AwaitStatus([](const status_t& s) { return s.revision == 30; }).tiles;
  PublishRemoval();
  AwaitStatus([](const status_t& s) {
    return s.last_problem.find("ignored here because of --no-remote") != std::string::npos;
  });
  daemon_.reset();
  Start();
  EXPECT_EQ(AwaitStatus([](const status_t&) { return true; }).tiles, tiles);
  EXPECT_TRUE(SavedMap()->settings.records().empty());
}

TEST_F(DaemonTest, ALayerWithoutRoomToCountOnGoesOnAsAnotherFromTheBeginning) {
  for (const auto& [session_number, revision] :
       {std::pair{SessionId::kMaxNumber, uint64_t{5}}, std::pair{uint64_t{1}, kMaxRevision}}) {
    std::filesystem::remove(config_.map());
    MapWriter map({});
    Layer& layer = map.AddLayer({"robot", 7}, {session_number, 1});
    layer.RestoreRevision(revision - 1);
    layer.BeginCommit();
    for (int k = 0; k < 20; ++k) layer.EditTile({k, 50}).control_points.fill(300);
    ASSERT_TRUE(MapFile::Open(config_.map())->Save(map.Layers()).ok());
    Start();
    Drive(20);
    ASSERT_TRUE(daemon_->Stop().ok());
    const auto saved = SavedMap();
    ASSERT_EQ(saved->layers.size(), 1u);
    EXPECT_NE(saved->layers[0].id.origin, 7u);
    EXPECT_EQ(saved->layers[0].id, saved->own_layer);
    EXPECT_EQ(saved->layers[0].session.number, 1u);
    EXPECT_EQ(saved->layers[0].revision, 21u);
    EXPECT_EQ(saved->layers[0].tiles.RevisionOf({3, 50}), 1u);
    const auto view = ViewOf(*saved);
    EXPECT_EQ(*FindTile(view->tiles, {3, 50}), *FindTile(map.View()->tiles, {3, 50}));
    daemon_.reset();
  }
}

TEST_F(DaemonTest, ADamagedMapIsContinuedAndTheFileAsItWasIsKept) {
  Start();
  Drive(30);
  ASSERT_TRUE(daemon_->Stop().ok());
  daemon_.reset();
  const auto before = SavedMap();
  {
    std::fstream file(config_.map(), std::ios::in | std::ios::out | std::ios::binary);
    file << std::string(4096, '\xff');  // the page without which it is no database
  }
  Start();
  const status_t status = AwaitStatus([](const status_t&) { return true; });
  EXPECT_NE(status.last_problem.find(".damaged"), std::string::npos) << status.last_problem;
  EXPECT_EQ(status.tiles, static_cast<int64_t>(ViewOf(*before)->tiles.size()));
  ASSERT_TRUE(daemon_->Stop().ok());
  EXPECT_EQ(SavedMap()->layers[0].id, before->layers[0].id);
  EXPECT_EQ(SavedMap()->layers[0].session.number, 2u);
  EXPECT_EQ(directory_.CountFiles(), 2);
}

TEST_F(DaemonTest, AMapThatIsRemovedIsMadeAnew) {
  Start();
  Drive(20);
  AwaitStatus([](const status_t& s) { return s.saved_revision == 20; });
  std::filesystem::remove(config_.map());
  EXPECT_TRUE(daemon_->Stop().ok());
  EXPECT_EQ(SavedMap()->layers[0].revision, 20u);
}

TEST_F(DaemonTest, AMapThatIsReplacedGoesOnInARescueFileAndTheOtherStays) {
  Start();
  Drive(20);
  AwaitStatus([](const status_t& s) { return s.saved_revision == 20; });
  std::filesystem::remove(config_.map());
  std::ofstream(config_.map()) << "of somebody else";
  Drive(20, 10'000);
  const status_t status = AwaitStatus([](const status_t& s) { return s.saved_revision == 40; });
  EXPECT_NE(status.last_problem.find(".rescue-"), std::string::npos) << status.last_problem;
  Drive(20, 20'000);
  AwaitStatus([](const status_t& s) { return s.saved_revision == 60; });
  const std::string end(daemon_->Stop().message());
  const size_t begin = end.find("the map is in ") + 14;
  const auto rescued = ReadMapFile(end.substr(begin, end.find(',', begin) - begin));
  ASSERT_TRUE(rescued.ok()) << end;
  EXPECT_EQ(rescued->set.layers[0].revision, 60u);
  std::ifstream other(config_.map());
  EXPECT_EQ(std::string(std::istreambuf_iterator<char>(other), {}), "of somebody else");
}

TEST_F(DaemonTest, AMapWhoseFolderIsGoneGoesOnInTheTemporaryFolder) {
  const TemporaryDirectory temporary;
  setenv("TMPDIR", temporary.path().c_str(), 1);
  const std::string folder = directory_.File("folder");
  std::filesystem::create_directory(folder);
  config_.set_map(folder + "/robot.splinemap");
  Start();
  Drive(20);
  AwaitStatus([](const status_t& s) { return s.saved_revision == 20; });
  std::filesystem::remove_all(folder);
  const std::string end(daemon_->Stop().message());
  EXPECT_NE(end.find("the map is in " + temporary.path()), std::string::npos) << end;
  EXPECT_EQ(temporary.CountFiles(), 1);
  daemon_.reset();

  std::filesystem::create_directory(folder);
  setenv("TMPDIR", "/nowhere", 1);
  Start();
  Drive(20);
  AwaitStatus([](const status_t& s) { return s.saved_revision == 20; });
  std::filesystem::remove_all(folder);
  const std::string lost(daemon_->Stop().message());
  EXPECT_NE(lost.find("the last 20 of 20 commits"), std::string::npos) << lost;
  unsetenv("TMPDIR");
}

TEST_F(DaemonTest, ATrajectoryMakesTheMapThatTheRightPosesWouldHaveMade) {
  const TileTree right = TilesAfter([&] {
    Drive(300);
    Drive(100, 30'000);
  });
  Start();
  Drive(300, 0, 0.002);
  AwaitStatus([](const status_t& s) { return s.scans_mapped == 300; });
  PublishTrajectory(300);
  Drive(100, 30'000);  // from here on the localisation is right
  AwaitSession(2);
  AwaitStatus([](const status_t& s) { return s.scans_mapped == 400; });
  ExpectTiles(right);
}

TEST_F(DaemonTest, ScansAfterTheLastPoseMoveWithItUntilTheLocalisationIsRight) {
  Start();
  Drive(100, 0, 0.01);
  AwaitStatus([](const status_t& s) { return s.scans_mapped == 100; });
  trajectory_t message{};
  message.utime = 9'500'000;
  message.num_parts = 1;
  message.num_poses = 1;
  message.pose_utime = {9'000'000};
  message.x_m = {std::cos(9.0)};
  message.y_m = {std::sin(9.0)};
  message.yaw_rad = {9.0};
  bus_->Publish("SPLINEMAP_TRAJECTORY", message);
  AwaitSession(2);
  ASSERT_TRUE(daemon_->Stop().ok());
  const auto archive = SavedMap()->layers[0].archive;
  int n = 0;
  archive->ForEachPose([&](const ScanPose& pose) {
    const double drift = 0.01 * n - (n < 90 || n >= 95 ? 0 : 0.9);
    EXPECT_NEAR(pose.world_T_robot.ToPose().position_m.x(), std::cos(0.1 * n) + drift, 2e-6) << n;
    ++n;
  });
  EXPECT_EQ(n, 100);
}

TEST_F(DaemonTest, TheSameTrajectoryAgainIsNone) {
  const TileTree right = TilesAfter([&] { Drive(200); });
  Start();
  Drive(200, 0, 0.01);
  AwaitStatus([](const status_t& s) { return s.scans_mapped == 200; });
  for (int n = 0; n < 40; ++n) PublishTrajectory(200);
  AwaitSession(2);
  PublishTrajectory(200);
  std::this_thread::sleep_for(std::chrono::seconds(6));  // beyond the interval of corrections
  EXPECT_EQ(AwaitStatus([](const status_t&) { return true; }).session_number, 2);
  ExpectTiles(right);
}

TEST_F(DaemonTest, ATrajectoryThatCannotBeUsedIsNamedAndChangesNothing) {
  Start();
  Drive(50);
  AwaitStatus([](const status_t& s) { return s.scans_mapped == 50; });
  trajectory_t message{};
  message.utime = 1;
  message.num_parts = 1;
  message.num_poses = 2;
  message.pose_utime = {2'000'000, 1'000'000};
  message.x_m = message.y_m = message.yaw_rad = {0, 0};
  bus_->Publish("SPLINEMAP_TRAJECTORY", message);
  EXPECT_NE(AwaitStatus([](const status_t& s) {
              return s.last_problem.find("stamps have to increase") != std::string::npos;
            }).last_problem,
            "");
  message.pose_utime = {900'000'000'000, 900'000'000'001};  // another clock
  bus_->Publish("SPLINEMAP_TRAJECTORY", message);
  AwaitStatus([](const status_t& s) {
    return s.last_problem.find("clock of the scans") != std::string::npos;
  });
  EXPECT_EQ(AwaitStatus([](const status_t&) { return true; }).session_number, 1);
}

TEST_F(DaemonTest, AMapThatIsPlacedAndPlacedBackIsAsBefore) {
  config_.set_placement_channel("MAP_FRAME");
  const TileTree before = TilesAfter([&] { Drive(200); });
  config_.set_frame("1,0,90");
  const TileTree turned = TilesAfter([&] { Drive(200); });
  config_.clear_frame();
  const auto publish = [&](double x, double yaw) {
    bot_core::rigid_transform_t message{};
    message.trans[0] = x;
    message.quat[0] = std::cos(yaw / 2);
    message.quat[3] = std::sin(yaw / 2);
    bus_->Publish("MAP_FRAME", message);
  };
  Start();
  Drive(200);
  AwaitStatus([](const status_t& s) { return s.scans_mapped == 200; });
  publish(1, std::numbers::pi / 2);
  AwaitSession(2);
  ASSERT_TRUE(daemon_->Stop().ok());
  daemon_.reset();
  EXPECT_EQ(DifferentTiles(SavedMap()->layers[0].tiles, turned).size(), 0u);
  Start();                           // the frame is kept in the file
  publish(1, std::numbers::pi / 2);  // as it is: nothing happens
  publish(0, 0);
  AwaitSession(4);
  ASSERT_TRUE(daemon_->Stop().ok());
  daemon_.reset();
  const LayerSnapshot layer = SavedMap()->layers[0];
  EXPECT_TRUE(layer.archive->map_T_world.IsIdentity());
  EXPECT_EQ(DifferentTiles(layer.tiles, before).size(), 0u);
  EXPECT_GT(DifferentTiles(before, turned).size(), 0u);
  config_.set_frame("1,0,90");
  Start();  // a file in another frame is made anew
  ASSERT_TRUE(daemon_->Stop().ok());
  EXPECT_EQ(DifferentTiles(SavedMap()->layers[0].tiles, turned).size(), 0u);
}

TEST_F(DaemonTest, AFrameIsKeptInTheFileOfAMapThatIsEmpty) {
  config_.set_frame("1,0,90");
  const FixedPose2 frame = FrameOf(config_);
  Start();
  ASSERT_TRUE(daemon_->Stop().ok());
  daemon_.reset();
  config_.clear_frame();
  Start();
  ASSERT_TRUE(daemon_->Stop().ok());
  EXPECT_EQ(SavedMap()->layers[0].archive->map_T_world, frame);
}

TEST_F(DaemonTest, WhatIsForgottenWasNeverSeen) {
  const TileTree since = TilesAfter([&] { Drive(301, 970'000); });
  config_.mutable_service()->set_forget_after_min(0.5);
  Start();
  Drive(200, 0, 0.01);
  Drive(301, 970'000);
  AwaitSession(2);
  ExpectTiles(since);
}

TEST_F(DaemonTest, WithoutAnArchiveTheMapIsTheSameAndCannotBeMoved) {
  const TileTree before = TilesAfter([&] { Drive(200); });
  config_.mutable_service()->set_max_archive_mb(0);
  Start();
  Drive(200);
  AwaitStatus([](const status_t& s) { return s.scans_mapped == 200; });
  PublishTrajectory(200);
  AwaitStatus(
      [](const status_t& s) { return s.last_problem.find("max_archive_mb") != std::string::npos; });
  ExpectTiles(before);
  EXPECT_EQ(SavedMap()->layers[0].archive->num_scans(), 0);
}

TEST_F(DaemonTest, ErrorsAtTheStartAreReturned) {
  config_.set_map(directory_.File("no/such/folder/map"));
  EXPECT_FALSE(Daemon::Start(config_, *LcmBus::Open("memq://")).ok());
  config_.clear_pose();
  EXPECT_FALSE(Daemon::Start(config_, *LcmBus::Open("memq://")).ok());
}

// Its scans take more than the file may have, and its tiles do not.
TEST_F(DaemonTest, BeyondTheBudgetOfTheDiskTheOldestScansGoAndTheMapStaysTheSame) {
  constexpr int kScans = 6000;
  const TileTree right = TilesAfter([&] { Drive(kScans); });
  config_.mutable_service()->set_max_file_mb(1);
  Start();
  for (int n = 0; n < kScans; n += 500) {
    DriveFrom(n, 500);
    AwaitStatus([&](const status_t& status) { return status.scans_mapped == n + 500; });
    daemon_->PublishStatus();
  }
  AwaitStatus([&](const status_t&) {
    const LayerSnapshot layer = SavedMap()->layers[0];
    return layer.archive->base.scans > 0 && layer.archive->bytes() < (1 << 20);
  });
  ExpectTiles(right);
  const ScanArchive& archive = *SavedMap()->layers[0].archive;
  EXPECT_EQ(archive.base.scans + archive.num_scans(), kScans);
}

}  // namespace splinemap::daemon_test
