#include "lib/diagnosis/survey.h"

#include <gtest/gtest.h>

#include "lcmtypes/michigan/lidar_t.hpp"
#include "lcmtypes/michigan/occupancy_grid_t.hpp"
#include "lcmtypes/splinemap/layer_digest_t.hpp"
#include "lib/wire/encode.h"

namespace splinemap::survey_test {

using std::chrono::milliseconds;

std::vector<uint8_t> Scan(int64_t ms) {
  return Encode(PlanarLidarMessage(milliseconds(ms), std::vector<float>(400, 1), 0, 0.01));
}
std::vector<uint8_t> PoseAt(int64_t ms) { return Encode(PoseMessage({milliseconds(ms), {}})); }

TEST(SurveyTest, ChannelsAreListedWithTypeAndRate) {
  Survey survey;
  for (int n = 0; n <= 100; ++n) {
    survey.Add(milliseconds(100 * n), "LASER", Scan(100 * n));
    survey.Add(milliseconds(100 * n), "OTHER", std::vector<uint8_t>{0, 1, 2, 3, 4, 5, 6, 7, 8});
  }
  survey.Add(milliseconds(10'000), "TEXT", std::vector<uint8_t>{'h', 'i'});
  const std::vector<SurveyedChannel> channels = survey.channels();
  ASSERT_EQ(channels.size(), 3u);
  EXPECT_EQ(channels[0].type, MessageType::kPlanarLidar);
  EXPECT_EQ(channels[0].messages, 101);
  EXPECT_NEAR(channels[0].rate_hz, 10, 1e-9);
  EXPECT_EQ(channels[0].preset, "bot_core");
  EXPECT_EQ(channels[1].fingerprint, 0x0001020304050607U);
  EXPECT_FALSE(channels[1].type);
  EXPECT_FALSE(channels[2].fingerprint);
  EXPECT_NEAR(survey.duration_s(), 10, 1e-9);
}

TEST(SurveyTest, OddTimesAreCounted) {
  Survey survey;
  for (const int64_t ms : {0, 100, 100, 200, 150, 2150}) {
    survey.Add(milliseconds(5000 + ms), "POSE", PoseAt(ms));
  }
  survey.Add(milliseconds(8000), "POSE", PoseAt(2300));
  const auto pose = survey.Find("POSE");
  ASSERT_TRUE(pose);
  EXPECT_EQ(pose->repeated, 1);
  EXPECT_EQ(pose->stepped_back, 1);
  EXPECT_NEAR(pose->longest_gap_s, 2, 1e-9);
  EXPECT_NEAR(pose->lag_s, 5, 1e-9) << "the median";
}

TEST(SurveyTest, WhatCannotBeUsedIsCountedAndTheFirstIsTold) {
  Survey survey;
  survey.Add(Utime(0), "POSE", PoseAt(0));
  survey.Add(Utime(0), "POSE", Scan(0));
  std::vector<uint8_t> cut = PoseAt(1);
  cut.pop_back();
  survey.Add(Utime(0), "POSE", cut);
  EXPECT_EQ(survey.Find("POSE")->malformed, 2);
  EXPECT_NE(survey.Find("POSE")->complaint.find("planar_lidar_t"), std::string::npos);
}

TEST(SurveyTest, MessagesThatNoDaemonReadsHaveANameAndNoComplaint) {
  Survey survey;
  survey.Add(Utime(0), "SPLINEMAP_DIGESTS", Encode(layer_digest_t{}));
  survey.Add(Utime(0), "SLAM_MAP", Encode(michigan::occupancy_grid_t{}));
  for (const SurveyedChannel& channel : survey.channels()) {
    EXPECT_EQ(channel.malformed, 0) << channel.name;
    EXPECT_FALSE(channel.type);
    EXPECT_NE(FingerprintName(channel.fingerprint.value()), "");
  }
}

TEST(SurveyTest, AChannelThatBeginsOddlyGetsTheTypeOfWhatFollows) {
  Survey survey;
  survey.Add(Utime(0), "LASER", std::vector<uint8_t>{'h', 'e', 'l', 'l', 'o', ' ', 'y', 'o', 'u'});
  for (int n = 0; n < 10; ++n) survey.Add(milliseconds(n), "LASER", Scan(n));
  EXPECT_EQ(survey.Find("LASER")->type, MessageType::kPlanarLidar);
  EXPECT_EQ(survey.Find("LASER")->malformed, 1);
  EXPECT_EQ(survey.ScansOf("LASER").size(), 10u);
}

TEST(SurveyTest, MemoryIsBounded) {
  Survey survey;
  for (int n = 0; n < 4000; ++n) survey.Add(milliseconds(n), "LASER", Scan(n));
  for (int n = 0; n < 60'000; ++n) survey.Add(milliseconds(n), "POSE", PoseAt(n));
  for (int n = 0; n < 2000; ++n) survey.Add(Utime(0), "C" + std::to_string(n), PoseAt(0));
  EXPECT_EQ(survey.ScansOf("LASER").size(), Survey::kMaxScans);
  EXPECT_LE(survey.ScansOf("LASER")[0].ranges_m.size(), Survey::kMaxBeams);
  EXPECT_EQ(survey.PosesOf("POSE").newest(), milliseconds(int64_t{Survey::kMaxPoses} - 1));
  EXPECT_EQ(survey.channels().size(), Survey::kMaxChannels);
  int sampled = 0;
  for (const SurveyedChannel& channel : survey.channels()) {
    sampled += survey.PosesOf(channel.name).empty() ? 0 : 1;
  }
  EXPECT_EQ(sampled, Survey::kMaxPoseChannels);
}

TEST(SurveyTest, ChannelsAreChosenWhereThereIsNoChoice) {
  Survey survey;
  config::Config config;
  survey.Add(Utime(0), "LASER", Scan(0));
  EXPECT_FALSE(ChooseChannels(survey, config).ok()) << "no poses";
  survey.Add(Utime(0), "POSE", PoseAt(0));
  config.Clear();
  ASSERT_TRUE(ChooseChannels(survey, config).ok());
  EXPECT_EQ(config.scan(0).channel(), "LASER");
  EXPECT_EQ(config.pose(), "POSE");
  survey.Add(Utime(0), "ODOMETRY", PoseAt(0));
  config.Clear();
  const absl::Status status = ChooseChannels(survey, config);
  EXPECT_NE(std::string(status.message()).find("--pose ODOMETRY"), std::string::npos) << status;
  config.set_pose("LASER");
  EXPECT_FALSE(ChooseChannels(survey, config).ok()) << "of another type";
  config.set_pose("ODOMETER");
  EXPECT_EQ(ChooseChannels(survey, config).message(),
            "ODOMETER is no channel of poses (did you mean ODOMETRY?); there are: ODOMETRY, POSE");
}

TEST(SurveyTest, TypesAloneChooseAsAllOfItDoes) {
  Survey all, types;
  const auto add = [&](const std::string& channel, int64_t ms, const std::vector<uint8_t>& bytes) {
    all.Add(milliseconds(ms), channel, bytes);
    types.AddType(milliseconds(ms), channel, bytes);
  };
  for (int n = 0; n < 20; ++n) {
    add("LASER", 100 * n, Scan(100 * n));
    add("POSE", 100 * n, PoseAt(100 * n));
    add("OTHER", 100 * n, std::vector<uint8_t>(9));
  }
  config::Config of_all, of_types;
  ASSERT_TRUE(ChooseChannels(all, of_all).ok());
  ASSERT_TRUE(ChooseChannels(types, of_types).ok());
  EXPECT_EQ(of_types.ShortDebugString(), of_all.ShortDebugString());
  EXPECT_TRUE(types.ScansOf("LASER").empty()) << "what takes the time";
  add("ODOMETRY", 2000, PoseAt(2000));
  of_all.Clear();
  of_types.Clear();
  EXPECT_EQ(ChooseChannels(types, of_types).message(), ChooseChannels(all, of_all).message());
}

TEST(SurveyTest, StampsThatAreNoMicrosecondsAreNamed) {
  struct Case {
    int64_t unit_us;  // of one count of the stamps
    const char* text;
  };
  for (const Case& c : {Case{1, ""}, Case{1000, "milliseconds"}, Case{1'000'000, "seconds"}}) {
    Survey survey;
    for (int64_t us = 0; us < 20'000'000; us += 100'000) {
      survey.Add(Utime(1'700'000'000'000'000 + us), "LASER",
                 Encode(PlanarLidarMessage(Utime((1'700'000'000'000'000 + us) / c.unit_us),
                                           std::vector<float>(40, 1), 0, 0.1)));
    }
    const std::string odd = survey.Find("LASER")->odd_stamps;
    EXPECT_EQ(odd.empty(), c.unit_us == 1) << odd;
    EXPECT_NE(odd.find(c.text), std::string::npos) << odd;
  }
  Survey survey;
  for (int n = 0; n < 50; ++n) survey.Add(milliseconds(100 * n), "LASER", Scan(0));
  EXPECT_NE(survey.Find("LASER")->odd_stamps.find("do not count"), std::string::npos);
  const std::vector<RangeReadings> scans = survey.ScansAsReceived("LASER");
  ASSERT_EQ(scans.size(), 50u);
  EXPECT_EQ(scans[7].utime, milliseconds(700));
}

}  // namespace splinemap::survey_test
