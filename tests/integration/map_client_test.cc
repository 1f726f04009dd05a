// Clients and a daemon, on a bus of their own.
#include <gtest/gtest.h>

#include <atomic>
#include <cmath>
#include <cstdio>
#include <future>
#include <numbers>
#include <set>
#include <thread>

#include "lib/map/summed_layers.h"
#include "lib/wire/encode.h"
#include "services/splinemapd/daemon.h"
#include "splinemap/client.h"
#include "splinemap/file.h"
#include "splinemap/local_map.h"
#include "splinemap/replica.h"
#include "tests/support/queries.h"
#include "tests/support/temporary_directory.h"

namespace splinemap::map_client_test {

using std::chrono::milliseconds;
using std::chrono::steady_clock;

class MapClientTest : public testing::Test {
 protected:
  MapClientTest() {
    config_.set_name("robot");
    config_.set_map(directory_.File("robot.splinemap"));
    config_.set_pose("POSE");
    config_.add_scan()->set_channel("LASER");
    config_.mutable_service()->set_save_interval_s(3600);
  }

  void StartDaemon() {
    auto daemon = Daemon::Start(config_, *LcmBus::Open(""));
    ASSERT_TRUE(daemon.ok()) << daemon.status();
    daemon_ = *std::move(daemon);
  }
  void Connect() {
    auto client = MapClient::Connect("", {});
    ASSERT_TRUE(client.ok()) << client.status();
    client_ = *std::move(client);
  }

  // A robot that turns in a round room of 3 m; until the daemon has mapped it.
  void Drive(int scans) {
    const uint64_t before = Revision();
    for (int n = 0; n < scans; ++n) {
      utime_ += milliseconds(100);
      bus_->Publish("POSE", PoseMessage({utime_, {{0, 0}, 0.1 * n}}));
      bus_->Publish("LASER", PlanarLidarMessage(utime_, std::vector<float>(90, 3), 0,
                                                2 * std::numbers::pi / 90));
    }
    Await([&] { return Revision() == before + scans; });
  }
  uint64_t Revision() {
    const auto answer = client_->Ask(PointsQuery{});
    return answer.ok() ? answer->revision : 0;
  }
  // Of the wall.
  double LogOdds() {
    const auto answer = client_->Ask(PointsQuery{{{3.03, 0}}, false});
    EXPECT_TRUE(answer.ok()) << answer.status();
    return answer.ok() ? answer->samples[0].log_odds : 0;
  }

  template <typename Condition>
  void Await(Condition is_true) {
    const auto deadline = steady_clock::now() + std::chrono::seconds(20);
    while (!is_true()) {
      ASSERT_LT(steady_clock::now(), deadline);
      std::this_thread::sleep_for(milliseconds(10));
    }
  }

  TemporaryDirectory directory_;
  config::Config config_;
  std::unique_ptr<LcmBus> bus_ = *LcmBus::Open("");
  Utime utime_{0};
  std::unique_ptr<Daemon> daemon_;
  std::unique_ptr<MapClient> client_;
};

TEST_F(MapClientTest, AsksTheMapAsItGrows) {
  StartDaemon();
  Connect();
  EXPECT_EQ(client_->daemon().name, "robot");
  EXPECT_EQ(client_->daemon().session_number, 1u);
  EXPECT_EQ(LogOdds(), 0);
  Drive(20);
  EXPECT_GT(LogOdds(), 0);
}

TEST_F(MapClientTest, WhereNobodyAnswersItSaysSoInTime) {
  ClientOptions options;
  options.deadline = milliseconds(200);
  const auto begin = steady_clock::now();
  const auto client = MapClient::Connect("", options);
  EXPECT_TRUE(absl::IsDeadlineExceeded(client.status())) << client.status();
  EXPECT_LT(steady_clock::now() - begin, std::chrono::seconds(1));
  StartDaemon();
  options.robot = "another";
  const auto other = MapClient::Connect("", options).status();
  EXPECT_NE(std::string(other.message()).find("not only that of robot"), std::string::npos)
      << other;
}

TEST_F(MapClientTest, ADaemonThatEndsIsMissedAndTheNextStartIsFound) {
  StartDaemon();
  Connect();
  Drive(20);
  ASSERT_TRUE(daemon_->Stop().ok());
  daemon_.reset();
  std::promise<absl::Status> missed;
  client_->Start(PointsQuery{}, milliseconds(300),
                 [&](const auto& answer) { missed.set_value(answer.status()); });
  EXPECT_TRUE(absl::IsDeadlineExceeded(missed.get_future().get()));
  std::promise<absl::StatusOr<PointsQuery::Answer>> found;
  client_->Start(PointsQuery{}, std::chrono::seconds(20),
                 [&](auto answer) { found.set_value(std::move(answer)); });
  StartDaemon();
  const auto answer = found.get_future().get();
  ASSERT_TRUE(answer.ok()) << answer.status();
  EXPECT_EQ(answer->revision, 20u);
  EXPECT_EQ(client_->daemon().session_number, 2u);
}

TEST_F(MapClientTest, ManyQueriesAtOnceEachEndOnce) {
  StartDaemon();
  Connect();
  Drive(20);
  std::mt19937_64 random(1);
  std::atomic<int> answered = 0;
  std::atomic<int> cancelled = 0;
  std::vector<MapClient::RequestId> ids;
  for (int n = 0; n < 500; ++n) {
    ids.push_back(client_->Start(RandomPoints(random, n * 10), std::chrono::seconds(20),
                                 [&](const absl::StatusOr<PointsQuery::Answer>& answer) {
                                   answered += answer.ok() ? 1 : 0;
                                   cancelled += absl::IsCancelled(answer.status()) ? 1 : 0;
                                 }));
  }
  for (int n = 250; n < 500; ++n) client_->Cancel(ids[n]);
  Await([&] { return answered + cancelled == 500; });
  EXPECT_GE(answered, 250);
  EXPECT_GT(cancelled, 0);
  // What is under way at the end is cancelled.
  client_->Start(RandomPoints(random, 1'000'000), std::chrono::seconds(20),
                 [&](const auto& answer) { cancelled += answer.ok() ? 0 : 1000; });
  client_.reset();
  EXPECT_GE(cancelled, 1000);
}

// Who waits receives for all, and takes only his own answer.
TEST_F(MapClientTest, CallbacksAreCalledByTheClientsThreadWhileOthersWait) {
  StartDaemon();
  Connect();
  Drive(20);
  std::atomic<bool> is_over = false;
  std::vector<std::jthread> asking;
  std::atomic<int> answered = 0;
  for (int n = 0; n < 3; ++n) {
    asking.emplace_back([&] {
      while (!is_over) {
        const auto answer = client_->Ask(PointsQuery{{{3.03, 0}}, false});
        EXPECT_TRUE(answer.ok()) << answer.status();
        ++answered;
      }
    });
  }
  std::set<std::thread::id> threads;
  for (int n = 0; n < 300; ++n) {
    std::promise<std::thread::id> called;
    client_->Start(PointsQuery{{{3.03, 0}}, false}, std::chrono::seconds(20), [&](const auto& a) {
      EXPECT_TRUE(a.ok()) << a.status();
      called.set_value(std::this_thread::get_id());
    });
    threads.insert(called.get_future().get());
  }
  is_over = true;
  asking.clear();
  EXPECT_GT(answered, 0);
  EXPECT_EQ(threads.size(), 1u);
}

TEST_F(MapClientTest, SizesAreLimited) {
  StartDaemon();
  Connect();
  PointsQuery query;
  query.points_m.resize(MapClient::kMaxItems + 1);
  EXPECT_TRUE(absl::IsInvalidArgument(client_->Ask(query).status()));
}

TEST_F(MapClientTest, SaveIsDoneWhenItReturns) {
  StartDaemon();
  Connect();
  Drive(20);
  EXPECT_EQ(ReadMapFile(config_.map())->set.layers[0].revision, 0u);
  const absl::Status saved = client_->Save();
  EXPECT_TRUE(saved.ok()) << saved;
  EXPECT_EQ(ReadMapFile(config_.map())->set.layers[0].revision, 20u);
}

TEST_F(MapClientTest, ClearBeginsTheLayerAnewForEverybody) {
  StartDaemon();
  Connect();
  auto follower = *MapReplica::Follow("", {});
  Drive(20);
  Await([&] { return follower->View()->Evaluate(3.03, 0).log_odds > 0; });
  const RaysQuery rays{RaysOfScan({{0.1, 0}, 0}, {0, 1, 2, 3, 4, 5}, 5)};
  const DistancesQuery distances{{{0, 0}, {2, 1}, {2.5, 0}}};
  client_->Ask(rays)
      .status()
      .IgnoreError();  // so that the daemon has to forget what it knows for them
  client_->Ask(distances).status().IgnoreError();
  const absl::Status cleared = client_->Clear();
  EXPECT_TRUE(cleared.ok()) << cleared;
  EXPECT_EQ(client_->daemon().session_number, 2u);
  EXPECT_EQ(LogOdds(), 0);
  const auto saved = ReadMapFile(config_.map());
  EXPECT_TRUE(saved->corruption.empty());
  EXPECT_EQ(saved->set.layers[0].tiles.size(), 0u);
  EXPECT_EQ(saved->set.layers[0].session.number, 2u);
  Await([&] { return follower->View()->tiles.size() == 0; });
  EXPECT_EQ(follower->Ask(PointsQuery{{{3.03, 0}}, false})->samples[0].log_odds, 0);

  // And it goes on.
  Drive(10);
  EXPECT_GT(LogOdds(), 0);
  Await([&] { return follower->View()->Evaluate(3.03, 0).log_odds > 0; });
  const auto ends = client_->Ask(rays);
  const auto nearest = client_->Ask(distances);
  ASSERT_TRUE(daemon_->Stop().ok());
  const LocalMap map(ViewOf(ReadMapFile(config_.map())->set));
  EXPECT_GT(map.View()->Evaluate(3.03, 0).log_odds, 0);
  ASSERT_EQ(ends.status(), map.Ask(rays).status());
  EXPECT_TRUE(!ends.ok() || AreSame(*ends, *map.Ask(rays)));
  ASSERT_EQ(nearest.status(), map.Ask(distances).status());
  EXPECT_TRUE(!nearest.ok() || AreSame(*nearest, *map.Ask(distances)));
}

TEST_F(MapClientTest, ACommandForAnotherSessionOfTheLayerIsNotDone) {
  StartDaemon();
  Connect();
  auto second = *MapClient::Connect("", {});
  Drive(20);
  ASSERT_TRUE(client_->Clear().ok());
  Drive(20);
  const absl::Status refused = second->Clear();  // which it would do to the map of session 1
  EXPECT_TRUE(absl::IsFailedPrecondition(refused)) << refused;
  const std::string text(refused.message());
  EXPECT_NE(text.find("for session 1 of the layer, which is in session 2"), std::string::npos)
      << text;
  EXPECT_GT(LogOdds(), 0);
  EXPECT_TRUE(second->Clear().ok()) << "it knows now";
}

TEST_F(MapClientTest, SettingsOfALayerAreForEverybodyAndOnDisk) {
  StartDaemon();
  Connect();
  auto follower = *MapReplica::Follow("", {});
  Drive(20);
  Await([&] { return follower->View()->Evaluate(3.03, 0).log_odds > 0; });
  const LayerId id = ReadMapFile(config_.map())->set.layers[0].id;
  const double log_odds = LogOdds();
  ASSERT_TRUE(client_->Set({LayerCommand::kMute, id}).ok());
  EXPECT_EQ(LogOdds(), 0);
  Await([&] { return follower->View()->tiles.size() == 0; });
  EXPECT_TRUE(ReadMapFile(config_.map())->set.settings.Of(id).muted);
  EXPECT_EQ(ReadMapFile(config_.map())->set.layers[0].revision, 20u) << "and saved with it";
  ASSERT_TRUE(client_->Set({LayerCommand::kUnmute, id}).ok());
  EXPECT_EQ(LogOdds(), log_odds);
  ASSERT_TRUE(client_->Set({LayerCommand::kPlace, id, 0, {{1, 0}, 0}}).ok());
  EXPECT_EQ(client_->Ask(PointsQuery{{{4.03, 0}}, false})->samples[0].log_odds, log_odds);
  Await([&] { return follower->View()->Evaluate(4.03, 0).log_odds == log_odds; });

  for (const Pose2& nowhere : {Pose2{{4e7, 0}, 0}, Pose2{{0, NAN}, 0}, Pose2{{0, 0}, INFINITY}}) {
    EXPECT_TRUE(absl::IsInvalidArgument(client_->Set({LayerCommand::kPlace, id, 0, nowhere})));
  }
  EXPECT_TRUE(absl::IsNotFound(client_->Set({LayerCommand::kMute, {id.name, id.origin + 1}})));
  EXPECT_TRUE(absl::IsFailedPrecondition(client_->Set({LayerCommand::kRemove, id, 7})));
  // It was made anew in its place, in another session.
  EXPECT_TRUE(absl::IsFailedPrecondition(client_->Set({LayerCommand::kRemove, id, 1})));
  ASSERT_TRUE(client_->Set({LayerCommand::kRemove, id, 2}).ok());
  EXPECT_EQ(ViewOf(ReadMapFile(config_.map())->set)->tiles.size(), 0u);
  Await([&] { return follower->View()->tiles.size() == 0; });
  Drive(10);
  // What begins anew is in the frame of the robot that was placed.
  Await([&] { return follower->View()->Evaluate(4.03, 0).log_odds > 0; });
  EXPECT_EQ(follower->FollowedLayers()[0].session.number, LayerSettings::kSessionsPerGeneration);
}

TEST_F(MapClientTest, CommandsCanBeSwitchedOff) {
  config_.mutable_service()->set_remote_commands(false);
  StartDaemon();
  Connect();
  Drive(20);
  EXPECT_TRUE(absl::IsPermissionDenied(client_->Save()));
  EXPECT_TRUE(absl::IsPermissionDenied(client_->Clear()));
  const LayerId id = ReadMapFile(config_.map())->set.layers[0].id;
  EXPECT_TRUE(absl::IsPermissionDenied(client_->Set({LayerCommand::kMute, id})));
  EXPECT_GT(LogOdds(), 0);
}

// Printed beside the time of an LCM message there and back.
TEST_F(MapClientTest, APointCostsLittleMoreThanAnEcho) {
  StartDaemon();
  Connect();
  auto echo_bus = *LcmBus::Open("");
  echo_bus->Subscribe(
      "PING", [&](const std::string&, auto message) { echo_bus->PublishBytes("PONG", message); });
  std::jthread echo([&](const std::stop_token& stop) {
    while (!stop.stop_requested()) echo_bus->Handle(milliseconds(20));
  });
  int pongs = 0;
  bus_->Subscribe("PONG", [&](const std::string&, auto) { ++pongs; });
  const auto median_us = [](auto call) {
    std::vector<double> times_us;
    for (int n = 0; n < 301; ++n) {
      const auto begin = steady_clock::now();
      call();
      const std::chrono::duration<double, std::micro> time = steady_clock::now() - begin;
      times_us.push_back(time.count());
    }
    std::nth_element(times_us.begin(), times_us.begin() + 150, times_us.end());
    return times_us[150];
  };
  const std::vector<uint8_t> ping(60);
  const double echo_us = median_us([&] {
    bus_->PublishBytes("PING", ping);
    bus_->Handle(milliseconds(100));
  });
  const double point_us = median_us([&] { EXPECT_EQ(LogOdds(), 0); });
  EXPECT_GT(pongs, 290);
  std::printf("echo %.0f us, point %.0f us\n", echo_us, point_us);
  EXPECT_LT(point_us, 10'000) << "no tick of a thread in the way";
}

}  // namespace splinemap::map_client_test
