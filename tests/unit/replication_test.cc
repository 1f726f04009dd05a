// The protocol between the owner of a layer and its followers over random schedules: messages are
// lost, doubled, late and out of order, links are cut, followers come late and start anew, owners
// crash and go on from older files or from none. Time is virtual.
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <map>
#include <memory>
#include <optional>
#include <random>
#include <set>
#include <string>
#include <vector>

#include "absl/strings/escaping.h"
#include "lcmtypes/splinemap/layer_digest_t.hpp"
#include "lcmtypes/splinemap/layer_listing_t.hpp"
#include "lcmtypes/splinemap/layer_pull_t.hpp"
#include "lcmtypes/splinemap/layer_ref_t.hpp"
#include "lcmtypes/splinemap/layer_updates_t.hpp"
#include "lcmtypes/splinemap/node_listing_t.hpp"
#include "lcmtypes/splinemap/settings_t.hpp"
#include "lcmtypes/splinemap/tile_update_t.hpp"
#include "lib/layers/layer_pyramid.h"
#include "lib/replication/byte_budget.h"
#include "lib/replication/layer_follower.h"
#include "lib/replication/pyramid_publisher.h"
#include "lib/replication/session_guard.h"
#include "lib/tiles/tile_codec.h"
#include "tests/support/lossy_network.h"
#include "tests/support/map_writer.h"
#include "tests/support/num_schedules.h"
#include "tests/support/random_map.h"
#include "tests/support/replication_world.h"

namespace splinemap::replication_test {

template <typename Message>
Message FromHex(const std::string& hex) {
  const std::string bytes = absl::HexStringToBytes(hex);
  Message message;
  EXPECT_EQ(message.decode(bytes.data(), 0, static_cast<int>(bytes.size())), bytes.size());
  return message;
}

// Level, x and y of what the only pull asks for.
std::set<std::array<int, 3>> NodesOf(const std::vector<layer_pull_t>& pulls) {
  EXPECT_EQ(pulls.size(), 1);
  std::set<std::array<int, 3>> nodes;
  for (int k = 0; k < pulls.at(0).num_nodes; ++k) {
    nodes.insert({pulls[0].levels[k], pulls[0].xs[k], pulls[0].ys[k]});
  }
  return nodes;
}

// The example in bytes of lcmtypes/FOLLOWING.md.
TEST(ReplicationTest, TheDocumentedMessagesAreFollowed) {
  const std::string speaker = "99aabbccddeeff00";
  const std::string layer =
      "00000006726f626f7400"
      "1122334455667788000000000000000399aabbccddeeff000000";
  LayerFollower follower({"robot", 0x1122334455667788}, 1);
  follower.HandleDigest(FromHex<layer_digest_t>("1f29e6de6fcaabb9" + speaker + layer +
                                                "0000000300000000000f4240"
                                                "3fa999999999999afffff60000000a00"
                                                "00000000000000010000000000000001"
                                                "0000000000000001fa6a73deec14c502"
                                                "000000020000000000000000"),
                        kNow);
  EXPECT_EQ(NodesOf(follower.Tick(kNow + milliseconds(100)).nodes),
            NodesOf({FromHex<layer_pull_t>("54d71f1dd4bd67c10000000000000007" + layer +
                                           "00000004"
                                           "00000002000000020000000200000002"
                                           "ffffffff00000000ffffffff00000000"
                                           "ffffffffffffffff0000000000000000")}));
  follower.HandleListing(FromHex<layer_listing_t>("51456dbc02f83e74" + speaker + layer +
                                                  "000000000000000100000001"
                                                  "00000002ffffffff00000000"
                                                  "000000010ffa6a73deec14c5020000000000000000"),
                         kNow + milliseconds(100));
  EXPECT_EQ(NodesOf(follower.Tick(kNow + milliseconds(250)).nodes),
            (std::set<std::array<int, 3>>{{1, -1, 1}}));
  follower.HandleUpdates(FromHex<layer_updates_t>(
      "b53cd98dd48a0395" + speaker + layer +
      "00000001fffffffd0000000900000000000000010000000000000000fa6a73deec14c502"
      "0000003a28b52ffd60000785010040d8ffe600e600e6007da8e0c7f08535111086ff3f3f"
      "06fbffdfffffeffffff7fffffbfffffdff7f83ff11ac4a553205"));
  follower.Tick(kNow + milliseconds(250));
  EXPECT_TRUE(follower.matches_digest());
  const auto tile = FindTile(follower.Snapshot().tiles, {-3, 9});
  ASSERT_NE(tile, nullptr);
  for (int k = 0; k < Tile::kSize; ++k) {
    ASSERT_EQ(tile->control_points[k], k % Tile::kSide < 16 ? -40 : 230);
  }
}

TEST(ReplicationTest, WithoutLossPushesAreEnough) {
  World world({}, {}, 1);
  for (int n = 0; n < 3; ++n) world.AddFollower();
  for (int n = 0; n < 200; ++n) {
    world.Commit(10);
    world.Run(milliseconds(100));
  }
  world.Run(milliseconds(1500));
  EXPECT_TRUE(world.AllCaughtUp());
  for (size_t n = 0; n < world.num_followers(); ++n) {
    EXPECT_EQ(world.follower(n).counts().asked_tiles, 0);
    EXPECT_EQ(world.follower(n).counts().unusable, 0);
  }
}

TEST(ReplicationTest, NothingButTheDigestIsSentWhenNothingChanges) {
  World world({}, {}, 2);
  world.AddFollower();
  world.Commit(10);
  world.Run(milliseconds(3000));
  const int64_t bytes = world.bytes_sent();
  world.Run(milliseconds(10'000));
  EXPECT_LE(world.bytes_sent() - bytes, 10 * 160);
  EXPECT_TRUE(world.AllCaughtUp());
}

TEST(ReplicationTest, ACommitThatLeavesTheTilesAsTheyWereIsNotPushed) {
  World world({}, {}, 19);
  world.AddFollower();
  world.Commit(3);
  world.Run(milliseconds(2000));
  const int64_t tiles = world.tiles_sent();
  world.CommitAgain();
  world.Run(milliseconds(2000));
  EXPECT_EQ(world.tiles_sent() - tiles, 0);
  EXPECT_TRUE(world.AllCaughtUp());
}

TEST(ReplicationTest, ALateFollowerGetsTheWholeMap) {
  World world({}, {}, 3);
  for (int n = 0; n < 300; ++n) {
    world.Commit(40);
    world.Step();
  }
  world.Run(milliseconds(2000));
  world.AddFollower();
  world.Run(milliseconds(4000));
  EXPECT_TRUE(world.AllCaughtUp());
}

// Changes of the same tiles do not end, and still a late follower has them all soon.
TEST(ReplicationTest, ALateFollowerIsCaughtUpThoughChangesGoOn) {
  World world({}, {}, 14);
  world.AddFollower();
  for (int n = 0; n < 60; ++n) {
    world.Commit(2);
    world.Run(milliseconds(60));
  }
  world.AddFollower();
  int equal_seconds = 0;
  for (int n = 0; n < 200; ++n) {
    world.Commit(2);
    world.Run(milliseconds(60));
    if (n % 20 == 19) equal_seconds += world.follower(1).matches_digest() ? 1 : 0;
  }
  EXPECT_GE(equal_seconds, 8);
}

TEST(ReplicationTest, UnderLossNothingIsOldThoughChangesGoOn) {
  World world({.loss = 0.1, .doubling = 0, .max_delay = milliseconds(0)}, {}, 15);
  for (int n = 0; n < 4; ++n) world.AddFollower();
  for (int n = 0; n < 600; ++n) {
    world.Commit(3);
    world.Run(milliseconds(60));
    for (size_t k = 0; n > 100 && k < world.num_followers(); ++k) {
      const auto match = world.follower(k).last_match();
      ASSERT_TRUE(match);
      ASSERT_LT(world.network().now() - *match, milliseconds(7000));
    }
  }
}

// Differences are made to what the last digest told of, so each stands without those before it.
TEST(ReplicationTest, ALostPushIsMadeGoodByTheNextOne) {
  World world({}, {}, 16);
  world.AddFollower();
  world.Commit(0);
  world.Run(milliseconds(2500));
  ASSERT_TRUE(world.AllCaughtUp());
  // In step with the pushes, since the first lies just behind a digest.
  while (!world.DigestWasSent()) world.Step();
  for (int n = 0; n < 6; ++n) {
    world.network().SetCut(n < 4);
    world.Commit(0);
    world.Run(milliseconds(100));
  }
  world.Run(milliseconds(120));
  EXPECT_EQ(world.follower(0).counts().unusable, 0);
  EXPECT_EQ(world.follower(0).Snapshot().tiles.RevisionOf({0, 0}), world.OwnersLayer().revision);
  EXPECT_EQ(world.follower(0).counts().asked_tiles, 0);
}

TEST(ReplicationTest, TheCapHoldsForPushesAndAnswers) {
  PublisherOptions options;
  options.bytes_per_s = 10'000;
  World world({}, options, 17);
  for (int n = 0; n < 400; ++n) world.Commit(100);
  const LayerSnapshot file = world.OwnersLayer();
  world.StartOwner(&file);  // so that followers have to ask for it
  world.AddFollower();
  world.AddFollower();
  for (int second = 0; second < 10; ++second) {
    const int64_t bytes = world.bytes_of_owner();
    for (int n = 0; n < 10; ++n) {
      for (int k = 0; k < 20; ++k) world.Commit(100);
      world.Run(milliseconds(100));
    }
    // Beside it the digest, headers of messages, and what is left of the quarter of a second
    // before.
    EXPECT_LE(world.bytes_of_owner() - bytes, 1.5 * options.bytes_per_s);
  }
}

TEST(ReplicationTest, TheOldestChangeIsPushedFirst) {
  PublisherOptions options;
  options.bytes_per_s = 1000;
  MapWriter map(kMapOptions);
  Layer& layer = map.AddLayer(kId, {1, 1});
  PyramidPublisher publisher(layer.Snapshot(), kMapOptions, options);
  Random random(18);
  Clock::time_point now{std::chrono::hours(1)};
  for (int32_t tx = 0; tx < 20; ++tx) {
    layer.BeginCommit();
    layer.EditTile({tx, 0}) = RandomTile(random);
    publisher.SetLayer(layer.Snapshot(), now += milliseconds(1));
  }
  std::vector<int32_t> pushed;
  ByteBudget budget(options.bytes_per_s);
  for (int n = 0; n < 1000 && pushed.size() < 20; ++n) {
    now += milliseconds(100);
    budget.Refill(now, publisher.HasChanges(), publisher.HasPulls());
    for (const ReplicationMessage& message : publisher.Tick(now, budget)) {
      const auto* updates = std::get_if<layer_updates_t>(&message);
      if (updates == nullptr) continue;
      for (const tile_update_t& tile : updates->tiles) pushed.push_back(tile.tx);
    }
  }
  EXPECT_EQ(pushed.size(), 20u);
  EXPECT_TRUE(std::is_sorted(pushed.begin(), pushed.end()));
}

TEST(ReplicationTest, ALossHeardByManyIsMendedOnce) {
  World world({}, {}, 4);
  for (int n = 0; n < 32; ++n) world.AddFollower();
  world.Commit(10);
  world.Run(milliseconds(1500));
  ASSERT_TRUE(world.AllCaughtUp());
  // One update gets lost for all.
  world.network().SetCut(true);
  world.Commit(10);
  world.Run(milliseconds(200));
  world.network().SetCut(false);
  const int64_t tiles = world.tiles_sent();
  world.Run(milliseconds(4000));
  EXPECT_TRUE(world.AllCaughtUp());
  int64_t asked = 0;
  for (size_t n = 0; n < world.num_followers(); ++n)
    asked += world.follower(n).counts().asked_tiles;
  EXPECT_LE(world.tiles_sent() - tiles, 8);
  EXPECT_LE(asked, 32);  // of 4 x 32
}

TEST(ReplicationTest, AnOwnerThatStartsAgainFromItsFileSendsNothingAgain) {
  World world({}, {}, 5);
  world.AddFollower();
  for (int n = 0; n < 50; ++n) world.Commit(10);
  world.Run(milliseconds(3000));
  ASSERT_TRUE(world.AllCaughtUp());
  const LayerSnapshot file = world.OwnersLayer();
  const LayerSnapshot before = world.follower(0).Snapshot();
  const int64_t tiles = world.tiles_sent();
  world.StartOwner(&file);
  for (int n = 0; n < 200; ++n) {
    world.Step();
    // What is shown never is less than the map.
    ASSERT_EQ(world.follower(0).Snapshot().tiles.size(), before.tiles.size());
  }
  EXPECT_TRUE(world.AllCaughtUp());
  EXPECT_EQ(world.follower(0).Snapshot().session.number, 2u);
  EXPECT_EQ(world.tiles_sent() - tiles, 0);
}

TEST(ReplicationTest, AnOwnerWithAnOlderFileIsToldOfItsLaterSession) {
  World world({}, {}, 13);
  for (int n = 0; n < 32; ++n) world.AddFollower();
  world.Commit(10);
  const LayerSnapshot file = world.OwnersLayer();  // of session 1
  for (int session = 2; session <= 5; ++session) {
    const LayerSnapshot newest = world.OwnersLayer();
    world.StartOwner(&newest);
    world.Commit(10);
    world.Run(milliseconds(3500));
  }
  ASSERT_TRUE(world.AllCaughtUp());
  world.StartOwner(&file);  // session 2
  world.Commit(10);
  world.Run(milliseconds(20'000));
  EXPECT_TRUE(world.AllCaughtUp());
  EXPECT_EQ(world.OwnersLayer().session.number, 6u);
}

TEST(SessionGuardTest, OfTwoOwnersTheOneInTheLesserSessionBecomesAnotherLayer) {
  const LayerRef lesser{kId, {3, 5}, {}};
  const LayerRef greater{kId, {3, 6}, {}};
  SessionGuard of_lesser;
  of_lesser.HandleDigest(greater, lesser, kNow);
  EXPECT_FALSE(of_lesser.Next(lesser, kNow, 42)) << "one message may be a mistake";
  of_lesser.HandleDigest(greater, lesser, kNow + milliseconds(1000));
  of_lesser.HandleDigest(greater, lesser, kNow + milliseconds(2000));
  const auto next = of_lesser.Next(lesser, kNow + milliseconds(2000), 42);
  ASSERT_TRUE(next);
  EXPECT_TRUE(next->is_other_layer);
  EXPECT_EQ(next->ref.id, (LayerId{"robot", 42}));
  EXPECT_FALSE(of_lesser.Next(next->ref, kNow + milliseconds(2000), 43));

  SessionGuard of_greater;
  for (milliseconds t(0); t < milliseconds(10'000); t += milliseconds(500)) {
    of_greater.HandleDigest(lesser, greater, kNow + t);
    of_greater.HandleDigest(greater, greater, kNow + t);
    of_greater.HandleDigest({{"other", 7}, {99, 0}, {}}, greater, kNow + t);
    of_greater.HandleKnown(lesser, greater, kNow + t);
    EXPECT_FALSE(of_greater.Next(greater, kNow + t, 42));
  }
}

TEST(SessionGuardTest, OneForgedDigestOrPullChangesNothing) {
  const LayerRef own{kId, {3, 5}, {}};
  const LayerRef later{kId, {9, 6}, {}};
  SessionGuard guard;
  guard.HandleDigest(later, own, kNow);
  guard.HandleKnown(later, own, kNow);
  for (milliseconds t(0); t < milliseconds(20'000); t += milliseconds(500)) {
    EXPECT_FALSE(guard.Next(own, kNow + t, 42));
  }
  // Nor does one every now and then.
  guard.HandleDigest(later, own, kNow + milliseconds(21'000));
  guard.HandleKnown(later, own, kNow + milliseconds(21'000));
  EXPECT_FALSE(guard.Next(own, kNow + milliseconds(21'000), 42));
}

// Who asks for a later session may have it from an owner that is there.
TEST(SessionGuardTest, AFollowersWordCountsOnlyWhileNoOtherOwnerIsHeard) {
  const LayerRef own{kId, {3, 5}, {}};
  const LayerRef later{kId, {9, 6}, {}};
  SessionGuard guard;
  SessionGuard other_is_there;
  for (milliseconds t(0); t <= milliseconds(5000); t += milliseconds(1000)) {
    guard.HandleKnown(later, own, kNow + t);
    EXPECT_EQ(guard.Next(own, kNow + t, 42).has_value(), t == milliseconds(5000));
    if (t > milliseconds(2000)) continue;
    other_is_there.HandleKnown(later, own, kNow + t);
    other_is_there.HandleDigest(later, own, kNow + t);
  }
  EXPECT_TRUE(other_is_there.Next(own, kNow + milliseconds(2500), 42)->is_other_layer);
  const auto next = guard.Next(own, kNow + milliseconds(5000), 42);
  ASSERT_TRUE(next);
  EXPECT_FALSE(next->is_other_layer);
  EXPECT_EQ(next->ref, (LayerRef{kId, {10, 5}, {}}));
}

TEST(SessionGuardTest, AfterAStartThatNobodyCountsToComesAnotherLayer) {
  const LayerRef own{kId, {3, 5}, {}};
  SessionGuard guard;
  for (milliseconds t(0); t <= milliseconds(5000); t += milliseconds(1000)) {
    guard.HandleKnown({kId, {4 + LayerSettings::kMaxSessionsAhead, 6}, {}}, own, kNow + t);
  }
  const auto next = guard.Next(own, kNow + milliseconds(5000), 42);
  ASSERT_TRUE(next);
  EXPECT_TRUE(next->is_other_layer);
  EXPECT_EQ(next->ref.session.number, 1u);
}

// Tiles with valid checksums in the name of the owner, which it never had: changed ones, new ones,
// far away, with a revision that it has, or that it will have some day.
TEST(ReplicationTest, ForgedTilesAreFoundAndFetchedAnew) {
  World world({}, {}, 21);
  world.AddFollower();
  world.AddFollower({{}, TileBox{-4, -4, 4, 4}});
  world.AddFollower({{2, Statistic::kMax}, {}});
  for (int n = 0; n < 20; ++n) {
    world.Commit(6);
    world.Run(milliseconds(100));
  }
  world.SetTile({0, 0}, 77);
  world.Run(milliseconds(3000));
  ASSERT_TRUE(world.AllCaughtUp());
  const uint64_t revision = world.OwnersLayer().revision;
  int64_t forged = 0;
  for (const TileKey key : {TileKey{0, 0}, TileKey{1, -3}, TileKey{2, 900}, TileKey{90'000, -7}}) {
    for (const uint64_t claimed : {revision, revision + 1, revision + 100'000}) {
      world.Forge(key, claimed, 500);
      world.Run(milliseconds(5000));
      for (size_t n = 0; n < 3; ++n)
        EXPECT_TRUE(world.follower(n).caught_up() && world.IsEqual(n))
            << n << " " << world.follower(n).caught_up() << world.IsEqual(n) << " "
            << world.follower(n).Snapshot().revision << " " << key.tx << " " << key.ty << " "
            << claimed;
      EXPECT_EQ(world.follower(0).Snapshot().revision, revision);
      if (world.follower(0).counts().disowned > forged) ++forged;
    }
  }
  // Where a tile of that revision is there already, it is not even looked at.
  EXPECT_EQ(forged, 4 * 3 - 1);
}

TEST(ReplicationTest, AForgedTileIsFoundWhileTheOwnerGoesOnMapping) {
  World world({.loss = 0.05}, {}, 22);
  world.AddFollower();
  for (int n = 0; n < 300; ++n) {
    world.Commit(2);
    if (n == 100) world.Forge({30, 30}, world.OwnersLayer().revision + 5000, 500);
    if (n == 100) world.Forge({1, 1}, world.OwnersLayer().revision + 5000, 500);
    world.Run(milliseconds(60));
  }
  EXPECT_EQ(world.follower(0).Snapshot().tiles.Find({30, 30}), nullptr);
  world.Run(milliseconds(5000));
  EXPECT_TRUE(world.AllCaughtUp());
}

TEST(ReplicationTest, TilesThatCannotBeAreRefusedOnArrival) {
  World world({}, {}, 23);
  world.AddFollower();
  world.SetTile({0, 0}, 77);
  world.Run(milliseconds(2000));
  const uint64_t revision = world.OwnersLayer().revision;
  world.Forge({0, 0}, revision + 1, kMapOptions.limits.max + 1);
  world.Forge({0, 0}, revision + 1, kMapOptions.limits.min - 1);
  world.Forge({0, 0}, kMaxRevision, 5);
  world.Forge({5, 5}, 0, 5);
  world.Forge({(1 << 23) + 1, 0}, revision + 1, 5);
  EXPECT_EQ(world.follower(0).counts().unusable, 5);
  EXPECT_TRUE(world.AllCaughtUp());
}

TEST(ReplicationTest, WhatComesAfterTheLastDigestOfAnOwnerThatIsGoneIsDropped) {
  World world({}, {}, 24);
  world.AddFollower();
  world.Commit(5);
  world.Run(milliseconds(3000));
  ASSERT_TRUE(world.AllCaughtUp());
  world.SilenceOwner(true);
  const uint64_t revision = world.OwnersLayer().revision;
  world.Forge({0, 0}, revision + 1, 500);
  world.Run(milliseconds(4000));
  EXPECT_TRUE(world.IsEqual(0));
  world.Forge({0, 0}, revision + 1, 500);  // nobody asked for it
  world.Run(milliseconds(4000));
  EXPECT_TRUE(world.IsEqual(0));
}

// A session without content would be whole at once.
TEST(ReplicationTest, OneForgedDigestDoesNotReplaceALayer) {
  World world({}, {}, 25);
  world.AddFollower();
  world.Commit(5);
  world.Run(milliseconds(3000));
  world.ForgeDigest(5);
  for (int n = 0; n < 100; ++n) {
    world.Run(milliseconds(100));
    EXPECT_TRUE(world.IsEqual(0));
  }
  EXPECT_TRUE(world.AllCaughtUp());
  EXPECT_EQ(world.OwnersLayer().session.number, 1u) << "the owner need not begin another session";
  // Nor while the owner is away.
  world.SilenceOwner(true);
  world.ForgeDigest(5);
  world.Run(milliseconds(15'000));
  EXPECT_TRUE(world.IsEqual(0));
}

TEST(ReplicationTest, ADigestOfAForgedStateHidesTheOwnersForSecondsOnly) {
  World world({}, {}, 27);
  world.AddFollower();
  world.Commit(5);
  world.Run(milliseconds(3000));
  layer_digest_t digest = world.last_digest();
  digest.state += int64_t{1} << 40;
  digest.hash = 99;
  world.follower(0).HandleDigest(digest, world.network().now());
  for (int n = 0; n < 5; ++n) {
    world.Commit(5);
    world.Run(milliseconds(1000));
  }
  world.Run(milliseconds(1500));
  EXPECT_TRUE(world.AllCaughtUp());
}

TEST(ReplicationTest, ASessionThatNobodyHasIsGivenUpForTheOneBeforeThoughItWasSpokenOfForLong) {
  World world({}, {}, 28);
  world.AddFollower();
  world.Commit(5);
  world.Run(milliseconds(3000));
  world.SilenceOwner(true);
  for (int n = 0; n < 5; ++n) {
    world.ForgeDigest(5, 99);
    world.Run(milliseconds(1000));
  }
  EXPECT_EQ(world.follower(0).session().number, 5u);
  EXPECT_TRUE(world.IsEqual(0)) << "what was there is shown";
  world.Run(milliseconds(12'000));
  EXPECT_EQ(world.follower(0).session().number, 1u);
  EXPECT_FALSE(world.follower(0).ShowsPreviousSession());
  EXPECT_TRUE(world.IsEqual(0));
}

TEST(ReplicationTest, AForgedDigestThatComesFirstIsForgottenForTheOwners) {
  World world({}, {}, 26);
  world.Commit(5);
  world.Run(milliseconds(2000));
  world.AddFollower();
  world.ForgeDigest(5);
  world.Run(milliseconds(8000));
  EXPECT_TRUE(world.AllCaughtUp());
  EXPECT_EQ(world.OwnersLayer().session.number, 1u);
}

TEST(ReplicationTest, APullOfAnotherSessionIsNotAnswered) {
  World world({}, {}, 20);
  world.Commit(5);
  world.Run(milliseconds(2000));
  const int64_t bytes = world.bytes_of_owner();
  const SessionId session = world.OwnersLayer().session;
  for (const LayerRef& other :
       {LayerRef{kId, {session.number + 1, 0}, {}}, LayerRef{{"other", 7}, session, {}},
        LayerRef{kId, session, {9, Statistic::kMean}}}) {
    layer_pull_t pull;
    pull.layer = ToMessage(other);
    pull.levels = {1};
    pull.xs = {0};
    pull.ys = {0};
    pull.num_nodes = 1;
    world.publisher().HandlePull(pull, world.network().now());
  }
  world.Run(milliseconds(500));
  EXPECT_EQ(world.publisher().foreign_pulls(), 3);
  EXPECT_LE(world.bytes_of_owner() - bytes, 160);  // a digest at most
}

TEST(ReplicationTest, AnOlderSessionIsIgnored) {
  World world({}, {}, 6);
  world.AddFollower();
  world.Commit(5);
  world.Run(milliseconds(2000));
  layer_digest_t old;
  old.speaker = 99;
  old.layer = ToMessage({kId, {0, 99}, {}});
  old.protocol_version = kProtocolVersion;
  world.follower(0).HandleDigest(old, world.network().now());
  EXPECT_TRUE(world.AllCaughtUp());
  EXPECT_EQ(world.follower(0).counts().stale, 1);
}

TEST(ReplicationTest, AnUpdateThatComesLateDoesNotReplaceANewerTile) {
  MapWriter map(kMapOptions);
  Layer& layer = map.AddLayer(kId, {1, 1});
  const auto updates_of = [&](ControlPoint value) {
    layer.BeginCommit();
    layer.EditTile({0, 0}).control_points[0] = value;
    PyramidPublisher publisher({kId, {1, 1}, 0, {}}, kMapOptions, {});
    publisher.SetLayer(layer.Snapshot(), Clock::now());
    return TickOf(publisher, Clock::now());  // a digest, and the tile
  };
  const auto older = updates_of(4);
  const auto newer = updates_of(5);
  LayerFollower follower(kId, 1);
  follower.HandleDigest(std::get<layer_digest_t>(older.at(0)), Clock::now());
  follower.HandleUpdates(std::get<layer_updates_t>(newer.at(1)));
  follower.HandleUpdates(std::get<layer_updates_t>(older.at(1)));
  EXPECT_EQ(FindTile(follower.Snapshot().tiles, {0, 0})->control_points[0], 5);
  EXPECT_EQ(follower.counts().stale, 1);
}

// What overtakes the first digest of a later session is none of the present one.
TEST(ReplicationTest, SessionsBeginWithADigest) {
  MapWriter map(kMapOptions);
  Layer& layer = map.AddLayer(kId, {1, 1});
  layer.BeginCommit();
  layer.EditTile({0, 0}).control_points[0] = 4;
  const auto messages_of = [&](SessionId session) {
    PyramidPublisher publisher({kId, session, 0, {}}, kMapOptions, {});
    publisher.SetLayer(layer.Snapshot(), Clock::now());
    return TickOf(publisher, Clock::now());  // a digest, and the tile
  };
  const auto present = messages_of({1, 1});
  layer.BeginCommit();
  layer.EditTile({0, 0}).control_points[0] = 5;
  const auto later = messages_of({2, 1});
  LayerFollower follower(kId, 1);
  follower.HandleUpdates(std::get<layer_updates_t>(present.at(1)));
  EXPECT_EQ(follower.Snapshot().tiles.size(), 0u);
  follower.HandleDigest(std::get<layer_digest_t>(present.at(0)), Clock::now());
  follower.HandleUpdates(std::get<layer_updates_t>(present.at(1)));
  follower.HandleUpdates(std::get<layer_updates_t>(later.at(1)));
  EXPECT_EQ(FindTile(follower.Snapshot().tiles, {0, 0})->control_points[0], 4);
}

// Late digests of one revision are no news; those of an owner whose clock was set back are.
TEST(ReplicationTest, AnOwnerWhoseClockIsSetBackIsFollowedOn) {
  LayerFollower follower(kId, 1);
  layer_digest_t digest;
  digest.speaker = 1;
  digest.layer = ToMessage({kId, {1, 1}, {}});
  digest.protocol_version = kProtocolVersion;
  digest.state = 3;
  digest.revision = 3;
  digest.num_tiles = 0;
  digest.hash = 0;
  digest.root_level = 1;
  digest.lag_s = 0;
  const Clock::time_point begin = Clock::now();
  digest.utime = 1'000'000'000;
  follower.HandleDigest(digest, begin);
  ASSERT_TRUE(follower.caught_up());
  digest.utime -= 500'000;
  follower.HandleDigest(digest, begin + milliseconds(100));
  EXPECT_EQ(follower.counts().stale, 1);
  digest.utime -= 3'600'000'000;
  follower.HandleDigest(digest, begin + milliseconds(1000));
  EXPECT_EQ(follower.counts().stale, 1);
  EXPECT_EQ(follower.last_match(), begin + milliseconds(1000));
}

TEST(ReplicationTest, AnotherVersionIsNotFollowed) {
  LayerFollower follower(kId, 1);
  layer_digest_t digest;
  digest.speaker = 1;
  digest.layer = ToMessage({kId, {1, 1}, {}});
  digest.protocol_version = kProtocolVersion + 1;
  follower.HandleDigest(digest, Clock::now());
  EXPECT_EQ(follower.counts().foreign, 1);
  EXPECT_FALSE(follower.caught_up());
}

// A map that is large for the rate, a follower that comes late, and commits that go on.
TEST(ReplicationTest, AnswersDoNotStarvePushes) {
  PublisherOptions options;
  options.bytes_per_s = 50'000;
  World world({}, options, 8);
  world.AddFollower();
  for (int n = 0; n < 400; ++n) world.Commit(100);
  world.Run(milliseconds(30'000));
  ASSERT_TRUE(world.AllCaughtUp());
  world.AddFollower();
  world.Run(milliseconds(1500));
  for (int n = 0; n < 10; ++n) {
    world.Commit(100);
    world.Run(milliseconds(200));
  }
  world.Run(milliseconds(1500));
  EXPECT_TRUE(world.IsEqual(0));
  EXPECT_FALSE(world.IsEqual(1));
  world.Run(milliseconds(60'000));
  EXPECT_TRUE(world.AllCaughtUp());
}

TEST(ReplicationTest, NodesThatCannotBeAreNoTrouble) {
  World world({}, {}, 9);
  world.AddFollower();
  world.Commit(5);
  world.Run(milliseconds(2500));
  const layer_ref_t layer = ToMessage({kId, world.OwnersLayer().session, {}});
  layer_pull_t pull;
  pull.layer = layer;
  pull.levels = {1, 1, 8, 9, -1, 0};
  pull.xs = {INT32_MAX, INT32_MIN, 5, 0, 0, INT32_MAX};
  pull.ys = {0, INT32_MIN, -7, 0, 0, 0};
  pull.num_nodes = 6;
  world.publisher().HandlePull(pull, world.network().now());
  // A digest that does not fit, and a listing of a tile that the owner does not have.
  layer_digest_t digest = world.last_digest();
  digest.utime += 1;
  digest.hash = 12345;
  world.follower(0).HandleDigest(digest, world.network().now());
  layer_listing_t listing;
  listing.layer = layer;
  listing.state = INT64_MAX;
  for (const int32_t level : {1, 0, 9, INT32_MAX}) {
    node_listing_t node;
    node.level = level;
    node.x = level == 1 ? 700 : INT32_MAX;
    node.y = 0;
    node.num_children = 1;
    node.children = {5};
    node.hashes = {1};
    node.revisions = {INT64_MAX};
    listing.nodes.push_back(node);
  }
  listing.num_nodes = static_cast<int32_t>(listing.nodes.size());
  world.follower(0).HandleListing(listing, world.network().now());
  world.Run(milliseconds(300));
  // The tile is asked for in vain; what gets lost now is mended all the same.
  world.network().SetCut(true);
  world.Commit(5);
  world.Run(milliseconds(140));
  world.network().SetCut(false);
  world.Run(milliseconds(40'000));
  EXPECT_TRUE(world.AllCaughtUp());
}

// The followers of a part catch up with it, and ask for little else.
TEST(ReplicationTest, APartCostsWhatItHolds) {
  World world({}, {}, 10);
  for (int n = 0; n < 500; ++n) world.Commit(60);
  world.Run(milliseconds(10'000));
  LayerFollower::Subset subset;
  subset.box = TileBox{-3, -5, 6, 7};
  const int64_t tiles = world.tiles_sent();
  world.AddFollower(subset);
  world.Run(milliseconds(3000));
  EXPECT_TRUE(world.AllCaughtUp());
  EXPECT_LE(world.tiles_sent() - tiles, 9 * 12);
  EXPECT_LT(world.follower(0).counts().asked_nodes, 20);
  // Changes elsewhere cost the listings down to where it ends, and changes in it are pushed.
  const int64_t asked_nodes = world.follower(0).counts().asked_nodes;
  for (int n = 0; n < 100; ++n) {
    world.Commit(60);
    world.Run(milliseconds(100));
    EXPECT_TRUE(world.follower(0).caught_up());
  }
  world.Run(milliseconds(1500));
  EXPECT_TRUE(world.AllCaughtUp());
  EXPECT_LE(world.follower(0).counts().asked_nodes - asked_nodes, 11 * 12);
  EXPECT_LE(world.follower(0).counts().asked_tiles, 9 * 12);
  // While nothing changes it asks for nothing.
  const int64_t bytes = world.bytes_sent();
  world.Run(milliseconds(10'000));
  EXPECT_LE(world.bytes_sent() - bytes, 10 * 160);
  EXPECT_TRUE(world.AllCaughtUp());
}

TEST(ReplicationTest, LossesInAPartAreNoticedAndMended) {
  World world({}, {}, 11);
  LayerFollower::Subset subset;
  subset.box = TileBox{0, 0, 3, 3};
  world.AddFollower(subset);
  for (int n = 0; n < 50; ++n) world.Commit(3);
  world.Run(milliseconds(3000));
  ASSERT_TRUE(world.AllCaughtUp());
  world.network().SetCut(true);
  for (int n = 0; n < 10; ++n) world.Commit(3);
  world.Run(milliseconds(200));
  world.network().SetCut(false);
  EXPECT_FALSE(world.AllCaughtUp());
  world.Run(milliseconds(3000));
  EXPECT_TRUE(world.AllCaughtUp());
}

// A hash that comes back says nothing of tiles that have changed meanwhile.
TEST(ReplicationTest, APartThatGoesBackToAnOlderStateIsNotTakenForEqual) {
  World world({}, {}, 21);
  LayerFollower::Subset subset;
  subset.box = TileBox{0, 0, 3, 3};
  world.AddFollower(subset);
  world.SetTile({1, 1}, 5);
  world.Run(milliseconds(4000));
  ASSERT_TRUE(world.AllCaughtUp());
  for (const bool is_digested : {false, true}) {
    world.SetTile({1, 1}, 6);
    world.Run(milliseconds(is_digested ? 4000 : 120));
    world.network().SetCut(true);
    world.SetTile({1, 1}, 5);
    world.Run(milliseconds(120));
    world.network().SetCut(false);
    world.Run(milliseconds(4000));
    EXPECT_TRUE(world.AllCaughtUp()) << is_digested;
  }
}

// More tiles than it asks for at a time.
TEST(ReplicationTest, AFollowerOfMuchIsCaughtUpOnlyWhenAllIsThere) {
  PublisherOptions options;
  options.bytes_per_s = 1e8;
  World world({}, options, 22);
  world.Fill(210);  // 44,100 tiles
  const LayerSnapshot file = world.OwnersLayer();
  world.StartOwner(&file);
  LayerFollower::Subset subset;
  subset.box = TileBox{0, 0, 205, 210};
  world.AddFollower(subset);
  for (int second = 0; second < 300 && !world.follower(0).caught_up(); ++second) {
    world.Run(milliseconds(1000));
  }
  EXPECT_TRUE(world.AllCaughtUp());
}

// Whatever is lost on the way is asked for again, and no tile waits for another digest. (Without
// digests the owner counts as silent, and less is asked for often.)
TEST(ReplicationTest, AFollowerOfMuchHasItAllFromOneDigest) {
  for (const double loss : {0.0, 0.02}) {
    PublisherOptions options;
    options.bytes_per_s = 1e8;
    options.digest_interval = std::chrono::hours(1);
    World world({.loss = loss}, options, 23);
    world.Fill(170);
    const LayerSnapshot file = world.OwnersLayer();
    world.StartOwner(&file);
    world.AddFollower();
    while (world.follower(0).session() == SessionId{}) {
      world.publisher().HandlePull(MakeCall(1), world.network().now());
      world.Run(milliseconds(200));
    }
    const int64_t digests = world.last_digest().utime;
    world.Run(milliseconds(loss == 0 ? 7000 : 20'000));
    EXPECT_EQ(world.follower(0).num_tiles(), 28'900u) << loss;
    EXPECT_EQ(world.last_digest().utime, digests);
  }
}

TEST(ReplicationTest, APublisherRestsWhileItsBudgetIsSpent) {
  PublisherOptions options;
  options.bytes_per_s = 10'000;
  MapWriter map(kMapOptions);
  Layer& layer = map.AddLayer(kId, {1, 1});
  layer.BeginCommit();
  Random random(24);
  layer_pull_t pull{};
  pull.layer = ToMessage(LayerRef{kId, {1, 1}, {}});
  for (int32_t tx = 0; tx < 100; ++tx) {
    layer.EditTile({tx, 0}) = RandomTile(random);
    pull.levels.push_back(0);
    pull.xs.push_back(tx);
    pull.ys.push_back(0);
  }
  pull.num_nodes = 100;
  PyramidPublisher publisher(layer.Snapshot(), kMapOptions, options);
  ByteBudget budget(options.bytes_per_s);
  budget.Refill(kNow, false, true);
  publisher.Tick(kNow, budget);
  publisher.HandlePull(pull, kNow);
  publisher.Tick(kNow, budget);
  ASSERT_TRUE(publisher.HasPulls());
  EXPECT_EQ(publisher.NextTick(kNow), kNow + ByteBudget::kPause);
}

TEST(ReplicationTest, AListingOfBeforeTheDigestDoesNotSatisfyIt) {
  MapWriter map(kMapOptions);
  Layer& layer = map.AddLayer(kId, {1, 1});
  layer.BeginCommit();
  layer.EditTile({0, 0}).control_points[0] = 4;
  PyramidPublisher publisher(layer.Snapshot(), kMapOptions, {});
  Clock::time_point now{std::chrono::hours(1)};
  const auto pull_roots = [&] {
    layer_pull_t pull;
    pull.layer = ToMessage({kId, {1, 1}, {}});
    pull.levels = {1, 1, 1, 1};
    pull.xs = {-1, 0, -1, 0};
    pull.ys = {-1, -1, 0, 0};
    pull.num_nodes = 4;
    publisher.HandlePull(pull, now);
    return TickOf(publisher, now += milliseconds(20));
  };
  LayerFollower::Subset subset;
  subset.box = TileBox{0, 0, 1, 1};
  LayerFollower follower(kId, 1, subset);
  const auto deliver = [&](const std::vector<ReplicationMessage>& messages) {
    for (const ReplicationMessage& message : messages) {
      if (const auto* digest = std::get_if<layer_digest_t>(&message)) {
        follower.HandleDigest(*digest, now);
      } else if (const auto* listing = std::get_if<layer_listing_t>(&message)) {
        follower.HandleListing(*listing, now);
      } else {
        follower.HandleUpdates(std::get<layer_updates_t>(message));
      }
    }
  };
  deliver(TickOf(publisher, now));
  const auto late = pull_roots();  // comes twice
  deliver(late);
  layer_pull_t pull;
  pull.layer = ToMessage({kId, {1, 1}, {}});
  pull.levels = {0};
  pull.xs = {0};
  pull.ys = {0};
  pull.num_nodes = 1;
  publisher.HandlePull(pull, now);
  deliver(TickOf(publisher, now += milliseconds(20)));  // the tile
  follower.Tick(now);
  ASSERT_TRUE(follower.caught_up());
  layer.BeginCommit();
  layer.EditTile({0, 0}).control_points[0] = 5;
  publisher.SetLayer(layer.Snapshot(), now);
  TickOf(publisher, now += milliseconds(200));           // the change, lost
  deliver(TickOf(publisher, now += milliseconds(900)));  // a digest
  deliver(late);
  follower.Tick(now += milliseconds(20));
  EXPECT_LT(follower.last_match(), now - milliseconds(500));  // nothing newer than the first digest
  EXPECT_FALSE(follower.matches_digest());
}

TEST(ReplicationTest, ACoarseLevelIsFollowedWhileSomebodyWantsIt) {
  World world({}, {}, 12);
  for (int n = 0; n < 1000; ++n) world.Commit(60);
  world.Run(milliseconds(15'000));
  const int64_t tiles = world.tiles_sent();
  LayerFollower::Subset subset;
  subset.level_of_detail = {3, Statistic::kMax};
  world.AddFollower(subset);
  world.Run(milliseconds(4000));
  EXPECT_TRUE(world.AllCaughtUp());
  EXPECT_LE(world.tiles_sent() - tiles, 17 * 17);  // of 14,400
  // It goes on for as long as it is followed, although nothing is asked for.
  world.Run(milliseconds(100'000));
  world.Commit(60);
  world.Run(milliseconds(3000));
  EXPECT_TRUE(world.AllCaughtUp());
  // And is given up when nobody does.
  world.RemoveFollowers();
  world.Run(milliseconds(40'000));
  const int64_t bytes = world.bytes_sent();
  world.Run(milliseconds(10'000));
  EXPECT_LE(world.bytes_sent() - bytes, 10 * 160);
}

LayerFollower::Subset RandomSubset(Random& random, int half_width) {
  LayerFollower::Subset subset;
  if (random() % 3 == 0) {
    subset.level_of_detail.level = static_cast<int>(1 + random() % 4);
    subset.level_of_detail.statistic = static_cast<Statistic>(random() % kNumStatistics);
  }
  if (random() % 3 == 0) {
    const auto any = [&] { return static_cast<int32_t>(random() % (2 * half_width)) - half_width; };
    TileBox box;
    box.Add({any(), any()});
    box.Add({any(), any()});
    subset.box = box;
  }
  return subset;
}

class RandomSchedule : public testing::TestWithParam<int> {};

TEST_P(RandomSchedule, EndsWithEqualBytes) {
  Random random(GetParam());
  for (int schedule = 0; schedule < NumSchedules(2); ++schedule) {
    const uint64_t seed = random();
    SCOPED_TRACE(seed);
    const auto any = [&](auto... values) { return AnyOf(random, values...); };
    const Weather weather{any(0.0, 0.01, 0.1, 0.3), any(0.0, 0.05, 0.5),
                          any(milliseconds(0), milliseconds(30), milliseconds(400))};
    PublisherOptions options;
    options.bytes_per_s = any(1e6, 1e5, 2e4);
    World world(weather, options, seed, any(Commits::kTiles, Commits::kScans));
    const int half_width = any(2, 10, 1000);
    const auto add_follower = [&] {
      world.AddFollower(RandomSubset(random, half_width), random() % 3 == 0 ? nullptr : Folder());
    };
    for (int n = any(1, 2, 5); n > 0; --n) add_follower();
    LayerSnapshot file = world.OwnersLayer();
    for (int event = 0; event < 60; ++event) {
      switch (random() % 16) {
        case 0:
          world.network().SetCut(true);
          break;
        case 1:
          add_follower();
          break;
        case 2:
          world.RestartFollower(random() % world.num_followers());
          break;
        case 3:
          file = world.OwnersLayer();
          break;
        case 4:
          world.StartOwner(&file);
          break;
        case 5:
          if (random() % 4 == 0) world.StartOwner(nullptr);
          break;
        case 6:
          world.SilenceOwner(true);
          break;
        case 7:
          world.Run(milliseconds(2000));
          break;
        default:
          world.network().SetCut(false);
          world.SilenceOwner(false);
          for (int n = 0; n < 5; ++n) {
            world.Commit(half_width);
            world.Run(milliseconds(60));
          }
      }
    }
    // From now on packets get through, most of them.
    world.network().SetCut(false);
    world.SilenceOwner(false);
    for (int second = 0; second < 120 && !world.AllCaughtUp(); ++second) {
      world.Run(milliseconds(1000));
    }
    ASSERT_TRUE(world.AllCaughtUp());
  }
}

INSTANTIATE_TEST_SUITE_P(Seeds, RandomSchedule, testing::Range(1, 9));

}  // namespace splinemap::replication_test
