#include "lib/replication/admission.h"

#include <gtest/gtest.h>

#include "lib/replication/layer_exchange.h"
#include "lib/replication/map_follower.h"
#include "tests/support/map_writer.h"
#include "tests/support/test_keys.h"

namespace splinemap::admission_test {

using std::chrono::milliseconds;

enum Who { kRobot, kOther, kBase, kViewer, kStranger };
constexpr uint64_t kSpeaker = 5;
constexpr uint64_t kRobotsNonce = 77;
const Clock::time_point kBegin{std::chrono::hours(1)};

std::shared_ptr<const KeyRing> Ring(Who who) {
  const auto key = [](Who whose) { return PublicKeyOf(TestSecret(whose)); };
  return *KeyRing::Make(TestSecret(who), {{"robot", key(kRobot), {"robot"}, false, false},
                                          {"other", key(kOther), {"other"}, false, false},
                                          {"base", key(kBase), {"base"}, true, true},
                                          {"viewer", key(kViewer), {}, false, false}});
}
std::vector<uint8_t> By(Who who, const ReplicationMessage& message) {
  return SignedMessage(Ring(who).get(), message);
}

// In the name of the owner, or of a proxy.
template <typename Message>
Message About(const std::string& layer, uint64_t speaker) {
  Message message{};
  message.speaker = static_cast<int64_t>(speaker);
  message.layer = ToMessage(LayerRef{{layer, 1}, {1, kRobotsNonce}, {}});
  if constexpr (std::is_same_v<Message, layer_digest_t>) {
    message.protocol_version = kProtocolVersion;
    message.knot_interval_m = 0.05;
    message.min_control_point = -100;
    message.max_control_point = 100;
    message.root_level = 1;
  }
  return message;
}

settings_t Settings(uint64_t counter, const std::string& layer = "robot") {
  settings_t settings{};
  settings.speaker = 9;
  settings.num_layers = 1;
  LayerSettings muted;
  muted.muted = true;
  muted.counter = counter;
  muted.writer = 9;
  settings.layers.push_back(ToMessage({layer, 1}, muted, true));
  return settings;
}

class AdmissionTest : public testing::Test {
 protected:
  bool IsAdmitted(Who who, const ReplicationMessage& message) {
    return admission_.Admit(By(who, message)).has_value();
  }
  int64_t Count(absl::StatusCode code) {
    const auto found = admission_.disbelieved().find(code);
    return found == admission_.disbelieved().end() ? 0 : found->second.count;
  }

  Admission admission_{"SPLINEMAP", Ring(kViewer), kSpeaker};
};

template <typename Message>
class SaidOfALayer : public AdmissionTest {};
using Said = testing::Types<layer_digest_t, layer_updates_t, layer_listing_t, layer_scans_t>;
TYPED_TEST_SUITE(SaidOfALayer, Said);

TYPED_TEST(SaidOfALayer, IsSaidByWhoMapsItOrAnswers) {
  const auto by_owner = About<TypeParam>("robot", kRobotsNonce);
  const auto by_proxy = About<TypeParam>("robot", 9);
  EXPECT_TRUE(this->IsAdmitted(kRobot, by_owner));
  EXPECT_TRUE(this->IsAdmitted(kBase, by_proxy));
  EXPECT_FALSE(this->IsAdmitted(kBase, by_owner)) << "who answers is not the robot";
  EXPECT_FALSE(this->IsAdmitted(kRobot, by_proxy));
  EXPECT_FALSE(this->IsAdmitted(kOther, by_owner));
  EXPECT_FALSE(this->IsAdmitted(kViewer, by_owner));
  EXPECT_EQ(this->Count(absl::StatusCode::kPermissionDenied), 4);
  EXPECT_FALSE(this->IsAdmitted(kStranger, by_owner));
  EXPECT_EQ(this->Count(absl::StatusCode::kNotFound), 1);
  EXPECT_FALSE(this->admission_.Admit(EncodeReplication(by_owner)).has_value());
  EXPECT_EQ(this->Count(absl::StatusCode::kUnauthenticated), 1);
  std::vector<uint8_t> forged = By(kRobot, by_owner);
  forged.back() ^= 1;
  EXPECT_FALSE(this->admission_.Admit(forged).has_value());
  EXPECT_EQ(this->Count(absl::StatusCode::kDataLoss), 1);
  EXPECT_EQ(this->admission_.believed(), 2);
}

TEST_F(AdmissionTest, WithoutKeysEverythingIsBelievedSignedOrNot) {
  Admission open("SPLINEMAP", nullptr, kSpeaker);
  const auto digest = About<layer_digest_t>("robot", kRobotsNonce);
  EXPECT_TRUE(open.Admit(EncodeReplication(digest)).has_value());
  EXPECT_TRUE(open.Admit(By(kStranger, digest)).has_value());
  EXPECT_TRUE(open.disbelieved().empty());
}

TEST_F(AdmissionTest, OneTrafficIsNotAnother) {
  Admission other("OTHER", Ring(kViewer), kSpeaker);
  EXPECT_FALSE(other.Admit(By(kRobot, About<layer_digest_t>("robot", kRobotsNonce))).has_value());
}

TEST_F(AdmissionTest, EverybodyWhoIsTrustedMayPull) {
  for (const Who who : {kRobot, kOther, kBase, kViewer}) {
    const auto pull = admission_.Admit(By(who, About<layer_pull_t>("robot", 9)));
    ASSERT_TRUE(pull.has_value());
    EXPECT_EQ(pull->answers, who == kBase) << "what the others know of sessions does not count";
    EXPECT_TRUE(IsAdmitted(who, About<scan_pull_t>("robot", 9)));
  }
  EXPECT_FALSE(IsAdmitted(kStranger, About<layer_pull_t>("robot", 9)));
}

TEST_F(AdmissionTest, SettingsAreTakenFromWhoDecides) {
  const auto by_base = admission_.Admit(By(kBase, Settings(3)));
  EXPECT_EQ(std::get<settings_t>(by_base->content).layers.size(), 1u);
  EXPECT_EQ(admission_.passed_counter(), 0u);
  const auto by_robot = admission_.Admit(By(kRobot, Settings(8)));
  EXPECT_EQ(std::get<settings_t>(by_robot->content).layers.size(), 0u);
  EXPECT_EQ(std::get<settings_t>(by_robot->content).num_layers, 0);
  EXPECT_EQ(admission_.passed_counter(), 8u);
  EXPECT_FALSE(IsAdmitted(kStranger, Settings(9)));
}

TEST_F(AdmissionTest, DaemonsSayWhatTheyHave) {
  layers_t layers{};
  layers.name = "robot";
  EXPECT_TRUE(IsAdmitted(kRobot, layers));
  EXPECT_TRUE(IsAdmitted(kBase, layers));
  EXPECT_FALSE(IsAdmitted(kOther, layers));
  EXPECT_FALSE(IsAdmitted(kViewer, layers));
}

// Of a layer with one tile in commit 1, and another one in commit 2.
class SignedFollowerTest : public testing::Test {
 protected:
  SignedFollowerTest() {
    map_.SetOwnLayer(layer_.id());
    Commit({0, 0}, 10);
    first_ = Say(kBegin);
    Commit({1, 0}, 20);
    second_ = Say(kBegin + milliseconds(2100));
  }

  using Messages = std::vector<std::vector<uint8_t>>;
  void Commit(TileKey key, ControlPoint value) {
    layer_.BeginCommit();
    layer_.EditTile(key).control_points.fill(value);
  }
  // What the owner says: a tile and a digest.
  Messages Say(Clock::time_point now) {
    if (!publisher_) publisher_.emplace(layer_.Snapshot(), map_.options(), PublisherOptions{});
    publisher_->SetLayer(layer_.Snapshot(), now);
    const auto root = About<layer_pull_t>("robot", 9);
    for (const TileKey key : {TileKey{0, 0}, TileKey{1, 0}}) {
      layer_pull_t pull = root;
      pull.num_nodes = 2;
      pull.levels = {1, 0};
      pull.xs = {0, key.tx};
      pull.ys = {0, key.ty};
      publisher_->HandlePull(pull, now);
    }
    ByteBudget budget(PublisherOptions().bytes_per_s);
    budget.Refill(now, true, true);
    Messages messages;
    for (const ReplicationMessage& message : publisher_->LastTick(now, budget)) {
      messages.push_back(By(kRobot, message));
    }
    return messages;
  }
  static void Hear(MapFollower& follower, const Messages& messages, Clock::time_point now) {
    ByteBudget budget(PublisherOptions().bytes_per_s);
    for (int times = 0; times < 3; ++times) {  // it asks, too
      for (const auto& message : messages) follower.HandleBytes(message, now);
      follower.Tick(now, budget);
    }
  }
  static FollowOptions Options() {
    FollowOptions options;
    options.keys = Ring(kViewer);
    options.takes_tiles = true;
    return options;
  }

  MapWriter map_{MapOptions{0.05, {-2560, 2560}}};
  Layer& layer_ = map_.AddLayer({"robot", 1}, {1, kRobotsNonce});
  std::optional<PyramidPublisher> publisher_;
  Messages first_;
  Messages second_;
};

TEST_F(SignedFollowerTest, RecordingsOfAnOwnerThatIsGoneShowNobodyToBeThere) {
  MapFollower follower(Options(), kSpeaker);
  Hear(follower, first_, kBegin);
  Hear(follower, first_, kBegin + milliseconds(100));
  ASSERT_EQ(follower.Layers().layers.at(0).tiles.size(), 1u);
  Hear(follower, second_, kBegin + milliseconds(2200));
  ASSERT_EQ(follower.Layers().layers.at(0).tiles.size(), 2u);
  for (Clock::time_point now = kBegin + milliseconds(2300); now < kBegin + milliseconds(30'000);
       now += milliseconds(200)) {
    Hear(follower, first_, now);
    Hear(follower, second_, now);
  }
  const auto end = kBegin + milliseconds(30'000);
  EXPECT_TRUE(follower.FollowedLayers(end).at(0).owner_is_silent);
  EXPECT_EQ(follower.Layers().layers.at(0).tiles.size(), 2u);
}

TEST_F(SignedFollowerTest, RecordingsTakeNothingFromACopyThatWasKept) {
  LayerSet kept;
  kept.options = map_.options();
  kept.layers.push_back(layer_.Snapshot());
  FollowOptions options = Options();
  MapFollower follower(options, {map_.options(), {"base", 1}, 1}, kept, kSpeaker, kBegin);
  for (Clock::time_point now = kBegin; now < kBegin + milliseconds(30'000);
       now += milliseconds(200)) {
    Hear(follower, first_, now);
  }
  EXPECT_EQ(follower.Layers().layers.at(0).tiles.size(), 2u);
  EXPECT_TRUE(follower.FollowedLayers(kBegin + milliseconds(30'000)).at(0).owner_is_silent);
}

class SignedExchangeTest : public testing::Test {
 protected:
  explicit SignedExchangeTest(Who who = kBase) {
    FollowOptions follow;
    follow.keys = Ring(who);
    LayerSet kept;
    kept.options = map_.options();
    exchange_.emplace(follow, PublisherOptions{}, layer_.Snapshot(), kept, kBegin);
  }
  absl::Status Mute() {
    return exchange_->Edit(layer_.id(), [](const SessionId&, LayerSettings& settings) {
      settings.muted = !settings.muted;
      return absl::OkStatus();
    });
  }

  MapWriter map_{MapOptions{0.05, {-2560, 2560}}};
  Layer& layer_ = map_.AddLayer({"robot", 1}, {1, kRobotsNonce});
  std::optional<LayerExchange> exchange_;
};

TEST_F(SignedExchangeTest, WhatIsDecidedIsLaterThanWhatRobotsHaveKept) {
  exchange_->HandleBytes(By(kOther, Settings(40)), kBegin);
  EXPECT_FALSE(exchange_->follower().settings().Of(layer_.id()).muted);
  ASSERT_TRUE(Mute().ok());
  EXPECT_EQ(exchange_->follower().settings().Of(layer_.id()).counter, 41u);
  // Nobody uses up the numbers.
  exchange_->HandleBytes(By(kOther, Settings(uint64_t{1} << 60)), kBegin);
  ASSERT_TRUE(Mute().ok());
  EXPECT_LT(exchange_->follower().settings().Of(layer_.id()).counter, uint64_t{1} << 33);
}

class UndecidedExchangeTest : public SignedExchangeTest {
 protected:
  UndecidedExchangeTest() : SignedExchangeTest(kRobot) {}
};

TEST_F(UndecidedExchangeTest, WhoMayNotDecideForOthersDecidesNothing) {
  const absl::Status status = Mute();
  EXPECT_TRUE(absl::IsPermissionDenied(status)) << status;
  EXPECT_FALSE(exchange_->follower().settings().Of(layer_.id()).muted);
}

// Pulls that name a greater session make an owner start another one, where they are believed.
TEST_F(UndecidedExchangeTest, SessionsAreChangedByWhoAnswersAlone) {
  const auto hear_for_8_s = [&](Who who) {
    layer_pull_t pull = About<layer_pull_t>("robot", 9);
    pull.layer.session_number = 12;
    for (int n = 0; n < 16; ++n) {
      exchange_->HandleBytes(By(who, pull), kBegin + milliseconds(500 * n));
    }
    return exchange_->NextSession(kBegin + milliseconds(8000), 1);
  };
  EXPECT_FALSE(hear_for_8_s(kStranger).has_value());
  EXPECT_FALSE(hear_for_8_s(kViewer).has_value());
  const auto next = hear_for_8_s(kBase);
  ASSERT_TRUE(next.has_value());
  EXPECT_EQ(next->ref.session.number, 13u);
}

}  // namespace splinemap::admission_test
