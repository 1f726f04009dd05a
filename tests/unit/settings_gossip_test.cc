#include "lib/replication/settings_gossip.h"

#include <gtest/gtest.h>

#include <optional>
#include <string>

#include "lcmtypes/splinemap/layer_settings_t.hpp"
#include "lcmtypes/splinemap/settings_t.hpp"

namespace splinemap::settings_gossip_test {

using std::chrono::milliseconds;
using std::chrono::minutes;

const Clock::time_point kBegin{std::chrono::hours(1)};
const LayerId kRobot{"robot", 1};
constexpr uint64_t kSessions = 7;  // of the robot

layer_settings_t Record(const LayerId& id, uint64_t counter) {
  layer_settings_t record{};
  record.name = id.name;
  record.origin = static_cast<int64_t>(id.origin);
  record.muted = 1;
  record.counter = static_cast<int64_t>(counter);
  record.writer = 5;
  return record;
}

// Of a daemon that has one layer, the robot's.
class SettingsGossipTest : public testing::Test {
 protected:
  bool Hear(const layer_settings_t& record, Clock::time_point now) {
    settings_t message{};
    message.speaker = 77;
    message.num_layers = 1;
    message.layers = {record};
    return gossip_.HandleSettings(
        message,
        [](const LayerId& id) {
          return id == kRobot ? std::optional<uint64_t>(kSessions) : std::nullopt;
        },
        now);
  }
  // A setting of its own, as a daemon makes it.
  bool CanSet(const LayerId& id) {
    LayerSettings setting = gossip_.settings().Next(id, 3);
    setting.low_weight = !setting.low_weight;
    gossip_.Set(id, setting);
    return setting.IsValid() && gossip_.settings().Of(id) == setting;
  }

  SettingsGossip gossip_{{}, 1};
};

TEST_F(SettingsGossipTest, ACounterThatJumpsIsRefused) {
  for (const uint64_t counter : {LayerSettings::kMaxSettingsAhead + 1, uint64_t{1} << 60,
                                 uint64_t{1} << 61, (uint64_t{1} << 61) + 1, ~uint64_t{0}}) {
    EXPECT_FALSE(Hear(Record(kRobot, counter), kBegin)) << counter;
  }
  EXPECT_EQ(gossip_.refused(), 5);
  EXPECT_FALSE(gossip_.settings().Of(kRobot).muted);
  EXPECT_TRUE(Hear(Record(kRobot, LayerSettings::kMaxSettingsAhead), kBegin));
  EXPECT_TRUE(CanSet(kRobot));
}

// A fleet whose counter was driven up tells its settings every second.
TEST_F(SettingsGossipTest, ACounterThatIsToldAgainAndAgainIsBelieved) {
  const layer_settings_t record = Record(kRobot, LayerSettings::kMaxSettingsAhead + 9);
  for (milliseconds t(0); t < milliseconds(10'000); t += milliseconds(1000)) {
    EXPECT_FALSE(Hear(record, kBegin + t));
  }
  EXPECT_TRUE(Hear(record, kBegin + milliseconds(10'000)));
  EXPECT_TRUE(CanSet(kRobot));
  // But not after pauses, and not up to the end of the numbers.
  const layer_settings_t last = Record(kRobot, uint64_t{1} << 61);
  const layer_settings_t rare = Record(kRobot, 3 * LayerSettings::kMaxSettingsAhead);
  for (milliseconds t(20'000); t < milliseconds(60'000); t += milliseconds(1000)) {
    EXPECT_FALSE(Hear(last, kBegin + t));
  }
  for (minutes t(2); t < minutes(20); t += minutes(1)) EXPECT_FALSE(Hear(rare, kBegin + t));
}

TEST_F(SettingsGossipTest, ARemovalOfSessionsThatNobodyCountsToIsRefused) {
  layer_settings_t record = Record(kRobot, 1);
  record.removed_up_to = static_cast<int64_t>(kSessions + LayerSettings::kMaxSessionsAhead + 1);
  EXPECT_FALSE(Hear(record, kBegin));
  record.removed_up_to = int64_t{1} << 61;
  EXPECT_FALSE(Hear(record, kBegin));
  EXPECT_EQ(gossip_.refused(), 2);
  // Nor does one that was heard before the layer.
  const LayerId late{"late", 2};
  record.name = late.name;
  record.origin = 2;
  EXPECT_TRUE(Hear(record, kBegin));
  EXPECT_TRUE(gossip_.SetHere(late, 3));
  EXPECT_FALSE(gossip_.settings().Of(late).IsRemoved({3, 1}));
  EXPECT_FALSE(gossip_.SetHere(late, 3));
}

TEST_F(SettingsGossipTest, RecordsAboutNobodyLeaveRoomForThoseAboutLayers) {
  for (uint64_t n = 0; n < 3000; ++n) {
    layer_settings_t record = Record({"nobody-" + std::to_string(n), n}, 1);
    record.has_layer = 1;
    Hear(record, kBegin + milliseconds(n));
  }
  EXPECT_EQ(gossip_.settings().records().size(), SettingsGossip::kMaxStrangers);
  EXPECT_TRUE(gossip_.LastingSettings().records().empty());
  EXPECT_TRUE(Hear(Record(kRobot, 2), kBegin + milliseconds(3000)));
  EXPECT_TRUE(CanSet({"own", 4}));
  EXPECT_EQ(gossip_.LastingSettings().records().size(), 2u);
}

TEST_F(SettingsGossipTest, RecordsAboutNobodyExpireAndDoNotComeBack) {
  const LayerId nobody{"nobody", 9};
  Hear(Record(kRobot, 1), kBegin);
  Hear(Record(nobody, 1), kBegin);
  gossip_.Tick(kBegin + minutes(59));
  EXPECT_TRUE(gossip_.settings().Of(nobody).muted);
  Hear(Record(nobody, 1), kBegin + minutes(59));  // by somebody who heard of it as well
  gossip_.Tick(kBegin + minutes(60));
  EXPECT_FALSE(gossip_.settings().Of(nobody).muted);
  EXPECT_FALSE(Hear(Record(nobody, 1), kBegin + minutes(61)));
  EXPECT_TRUE(gossip_.settings().Of(kRobot).muted);
  // Who has the layer tells of it with more right.
  layer_settings_t record = Record(nobody, 1);
  record.has_layer = 1;
  EXPECT_TRUE(Hear(record, kBegin + minutes(62)));
  Hear(record, kBegin + minutes(110));
  gossip_.Tick(kBegin + minutes(150));
  EXPECT_TRUE(gossip_.settings().Of(nobody).muted);
  // What turns up at last is here.
  gossip_.SetHere(nobody, 1);
  gossip_.Tick(kBegin + minutes(600));
  EXPECT_TRUE(gossip_.settings().Of(nobody).muted);
  EXPECT_EQ(gossip_.LastingSettings().records().size(), 2u);
}

TEST_F(SettingsGossipTest, WhoHasALayerSaysSo) {
  layer_settings_t nobody = Record({"nobody", 9}, 1);
  Hear(Record(kRobot, 1), kBegin);
  Hear(nobody, kBegin);
  gossip_.Tick(kBegin);
  const auto messages = gossip_.Tick(kBegin + milliseconds(1000));
  ASSERT_EQ(messages.size(), 1u);
  ASSERT_EQ(messages[0].layers.size(), 2u);
  EXPECT_EQ(messages[0].layers[0].name, "nobody");
  EXPECT_FALSE(messages[0].layers[0].has_layer);
  EXPECT_TRUE(messages[0].layers[1].has_layer);
}

}  // namespace splinemap::settings_gossip_test
