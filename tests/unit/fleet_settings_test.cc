#include "lib/fleet/fleet_settings.h"

#include <gtest/gtest.h>

#include "tests/support/memory_fleet_store.h"

namespace splinemap::fleet_settings_test {

const LayerId kRobot{"robot", 7};

class FleetSettingsTest : public testing::Test {
 protected:
  LayerSettings Stored() { return *ReadSettings(store_, kRobot); }
  absl::Status Mute() {
    return ChangeSettings(store_, kRobot, [](LayerSettings& settings) {
      settings.muted = true;
      return absl::OkStatus();
    });
  }
  absl::Status LowerWeight() {
    return ChangeSettings(store_, kRobot, [](LayerSettings& settings) {
      settings.low_weight = true;
      return absl::OkStatus();
    });
  }
  void Write(const std::string& value) {
    FleetEntry entry;
    entry.key = SettingsKey(kRobot);
    entry.value = value;
    ASSERT_TRUE(store_.Put({entry}).ok());
  }

  MemoryFleetStore store_;
};

TEST_F(FleetSettingsTest, AChangeKeepsWhatElseWasSetAndIsLater) {
  ASSERT_TRUE(Mute().ok());
  const LayerSettings before = Stored();
  EXPECT_TRUE(before.muted);
  ASSERT_TRUE(LowerWeight().ok());
  EXPECT_TRUE(Stored().muted && Stored().low_weight);
  EXPECT_EQ(Merge(before, Stored()), Stored());
}

TEST_F(FleetSettingsTest, WhoIsOvertakenChangesWhatTheOtherWrote) {
  int calls = 0;
  ASSERT_TRUE(ChangeSettings(store_, kRobot, [&](LayerSettings& settings) {
                settings.low_weight = true;
                return ++calls == 1 ? Mute() : absl::OkStatus();
              }).ok());
  EXPECT_EQ(calls, 2);
  EXPECT_TRUE(Stored().muted && Stored().low_weight);
}

TEST_F(FleetSettingsTest, OthersWhoWriteAllTheTimeAreNotWaitedForForEver) {
  const absl::Status status =
      ChangeSettings(store_, kRobot, [&](LayerSettings&) { return Mute(); });
  EXPECT_TRUE(absl::IsUnavailable(status)) << status;
}

TEST_F(FleetSettingsTest, ARecordThatWasDeletedIsWrittenAgain) {
  ASSERT_TRUE(Mute().ok());
  Write("");
  ASSERT_TRUE(LowerWeight().ok());
  EXPECT_TRUE(Stored().low_weight && !Stored().muted);
}

TEST_F(FleetSettingsTest, WhereAChangeIsRefusedNothingIsWritten) {
  const absl::Status status = ChangeSettings(store_, kRobot, [](LayerSettings& settings) {
    settings.muted = true;
    return absl::FailedPreconditionError("no");
  });
  EXPECT_TRUE(absl::IsFailedPrecondition(status)) << status;
  EXPECT_TRUE(absl::IsOutOfRange(store_.Get(SettingsKey(kRobot)).status()));
}

TEST_F(FleetSettingsTest, WhatIsDamagedIsNotTakenForNoSettings) {
  Write("damaged");
  EXPECT_TRUE(absl::IsDataLoss(ReadSettings(store_, kRobot).status()));
  EXPECT_TRUE(absl::IsDataLoss(Mute())) << Mute();
  EXPECT_EQ(store_.Get(SettingsKey(kRobot))->value, "damaged");
}

}  // namespace splinemap::fleet_settings_test
