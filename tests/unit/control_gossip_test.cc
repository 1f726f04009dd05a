#include "lib/replication/control_gossip.h"

#include <gtest/gtest.h>

#include <string>

namespace splinemap::control_gossip_test {

using std::chrono::milliseconds;
using std::chrono::minutes;

const Clock::time_point kBegin{std::chrono::hours(1)};
const LayerId kRobot{"robot", 1};
constexpr uint64_t kStarts = 7;  // of the robot

layer_control_t Record(const LayerId& id, uint64_t counter) {
  layer_control_t record{};
  record.name = id.name;
  record.origin = static_cast<int64_t>(id.origin);
  record.muted = 1;
  record.counter = static_cast<int64_t>(counter);
  record.writer = 5;
  return record;
}

// Of a daemon that has one layer, the robot's.
class ControlGossipTest : public testing::Test {
 protected:
  bool Hear(const layer_control_t& record, Clock::time_point now) {
    control_records_t message{};
    message.sender = 77;
    message.num_records = 1;
    message.records = {record};
    return gossip_.Take(
        message,
        [](const LayerId& id) {
          return id == kRobot ? std::optional<uint64_t>(kStarts) : std::nullopt;
        },
        now);
  }
  // A decision of its own, as a daemon makes it.
  bool CanDecide(const LayerId& id) {
    LayerControl control = gossip_.controls().Next(id, 3);
    control.yields = !control.yields;
    gossip_.Decide(id, control);
    return control.IsValid() && gossip_.controls().Of(id) == control;
  }

  ControlGossip gossip_{{}, 1};
};

TEST_F(ControlGossipTest, ACounterThatJumpsIsRefused) {
  for (const uint64_t counter : {LayerControl::kMaxDecisionsAhead + 1, uint64_t{1} << 60,
                                 uint64_t{1} << 61, (uint64_t{1} << 61) + 1, ~uint64_t{0}}) {
    EXPECT_FALSE(Hear(Record(kRobot, counter), kBegin)) << counter;
  }
  EXPECT_EQ(gossip_.refused(), 5);
  EXPECT_FALSE(gossip_.controls().Of(kRobot).muted);
  EXPECT_TRUE(Hear(Record(kRobot, LayerControl::kMaxDecisionsAhead), kBegin));
  EXPECT_TRUE(CanDecide(kRobot));
}

// A fleet whose counter was driven up tells its decisions every second.
TEST_F(ControlGossipTest, ACounterThatIsToldAgainAndAgainIsBelieved) {
  const layer_control_t record = Record(kRobot, LayerControl::kMaxDecisionsAhead + 9);
  for (milliseconds t(0); t < milliseconds(10'000); t += milliseconds(1000)) {
    EXPECT_FALSE(Hear(record, kBegin + t));
  }
  EXPECT_TRUE(Hear(record, kBegin + milliseconds(10'000)));
  EXPECT_TRUE(CanDecide(kRobot));
  // But not after pauses, and not up to the end of the numbers.
  const layer_control_t last = Record(kRobot, uint64_t{1} << 61);
  const layer_control_t rare = Record(kRobot, 3 * LayerControl::kMaxDecisionsAhead);
  for (milliseconds t(20'000); t < milliseconds(60'000); t += milliseconds(1000)) {
    EXPECT_FALSE(Hear(last, kBegin + t));
  }
  for (minutes t(2); t < minutes(20); t += minutes(1)) EXPECT_FALSE(Hear(rare, kBegin + t));
}

TEST_F(ControlGossipTest, ARemovalOfStartsThatNobodyCountsToIsRefused) {
  layer_control_t record = Record(kRobot, 1);
  record.removed_up_to = static_cast<int64_t>(kStarts + LayerControl::kMaxStartsAhead + 1);
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
  EXPECT_FALSE(gossip_.controls().Of(late).IsRemoved({3, 1}));
  EXPECT_FALSE(gossip_.SetHere(late, 3));
}

TEST_F(ControlGossipTest, RecordsAboutNobodyLeaveRoomForThoseAboutLayers) {
  for (uint64_t n = 0; n < 3000; ++n) {
    layer_control_t record = Record({"nobody-" + std::to_string(n), n}, 1);
    record.has_layer = 1;
    Hear(record, kBegin + milliseconds(n));
  }
  EXPECT_EQ(gossip_.controls().records().size(), ControlGossip::kMaxStrangers);
  EXPECT_TRUE(gossip_.LastingControls().records().empty());
  EXPECT_TRUE(Hear(Record(kRobot, 2), kBegin + milliseconds(3000)));
  EXPECT_TRUE(CanDecide({"own", 4}));
  EXPECT_EQ(gossip_.LastingControls().records().size(), 2u);
}

TEST_F(ControlGossipTest, RecordsAboutNobodyExpireAndDoNotComeBack) {
  const LayerId nobody{"nobody", 9};
  Hear(Record(kRobot, 1), kBegin);
  Hear(Record(nobody, 1), kBegin);
  gossip_.Tick(kBegin + minutes(59));
  EXPECT_TRUE(gossip_.controls().Of(nobody).muted);
  Hear(Record(nobody, 1), kBegin + minutes(59));  // by somebody who heard of it as well
  gossip_.Tick(kBegin + minutes(60));
  EXPECT_FALSE(gossip_.controls().Of(nobody).muted);
  EXPECT_FALSE(Hear(Record(nobody, 1), kBegin + minutes(61)));
  EXPECT_TRUE(gossip_.controls().Of(kRobot).muted);
  // Who has the layer tells of it with more right.
  layer_control_t record = Record(nobody, 1);
  record.has_layer = 1;
  EXPECT_TRUE(Hear(record, kBegin + minutes(62)));
  Hear(record, kBegin + minutes(110));
  gossip_.Tick(kBegin + minutes(150));
  EXPECT_TRUE(gossip_.controls().Of(nobody).muted);
  // What turns up at last is here.
  gossip_.SetHere(nobody, 1);
  gossip_.Tick(kBegin + minutes(600));
  EXPECT_TRUE(gossip_.controls().Of(nobody).muted);
  EXPECT_EQ(gossip_.LastingControls().records().size(), 2u);
}

TEST_F(ControlGossipTest, WhoHasALayerSaysSo) {
  layer_control_t nobody = Record({"nobody", 9}, 1);
  Hear(Record(kRobot, 1), kBegin);
  Hear(nobody, kBegin);
  gossip_.Tick(kBegin);
  const auto messages = gossip_.Tick(kBegin + milliseconds(1000));
  ASSERT_EQ(messages.size(), 1u);
  ASSERT_EQ(messages[0].records.size(), 2u);
  EXPECT_EQ(messages[0].records[0].name, "nobody");
  EXPECT_FALSE(messages[0].records[0].has_layer);
  EXPECT_TRUE(messages[0].records[1].has_layer);
}

}  // namespace splinemap::control_gossip_test
