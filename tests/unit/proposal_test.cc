#include "lib/diagnosis/proposal.h"

#include <gtest/gtest.h>

#include <cmath>

#include "lcmtypes/bot_core/rigid_transform_t.hpp"
#include "lcmtypes/michigan/lidar_t.hpp"
#include "lib/wire/encode.h"
#include "tests/support/room_drive.h"

namespace splinemap::proposal_test {

using std::chrono::milliseconds;
using std::chrono::seconds;

michigan::lidar_t LidarMessage(const RangeReadings& readings) {
  michigan::lidar_t message;
  message.utime = readings.utime.count();
  message.num_ranges = static_cast<int32_t>(readings.ranges_m.size());
  message.ranges = readings.ranges_m;
  message.thetas = readings.bearings_rad;
  message.intensities.resize(readings.ranges_m.size());
  message.times.assign(readings.ranges_m.size(), message.utime);
  for (size_t k = 0; k < readings.beam_utimes.size(); ++k) {
    message.times[k] = readings.beam_utimes[k].count();
  }
  return message;
}

// A log of a drive in a room, with SLAM poses and an odometry that drifts.
class ProposalTest : public testing::Test {
 protected:
  void Drive(const RoomDriver& driver, Utime odometry_clock = Utime(0), double turn = 1) {
    DriveInRoom(
        driver, turn,
        [&](const TimedPose& pose) {
          Add("SLAM", pose.utime, Encode(PoseMessage(pose)));
          TimedPose drifting = pose;
          drifting.world_T_robot.yaw_rad *= 1.2;
          drifting.utime += odometry_clock;
          Add("ODOMETRY", pose.utime, Encode(PoseMessage(drifting)));
        },
        [&](const RangeReadings& readings) {
          Add("LIDAR", readings.utime, Encode(LidarMessage(readings)));
        });
  }

  void Add(const std::string& channel, Utime utime, const std::vector<uint8_t>& message) {
    survey_.Add(utime + milliseconds(5), channel, message);
  }

  Survey survey_;
};

TEST_F(ProposalTest, TakesTheSharperPosesAndThePresetThatFits) {
  Drive({.sign = -1, .duration_s = 0.15, .beam_times = true});
  const auto proposal = Propose(survey_, {});
  ASSERT_TRUE(proposal.ok()) << proposal.status();
  EXPECT_EQ(proposal->pose, "SLAM");
  EXPECT_EQ(proposal->scan_flags, std::vector<std::string>{"LIDAR"}) << "the preset that is told";
  EXPECT_EQ(proposal->cautions, std::vector<std::string>()) << "it is clear";
  EXPECT_FALSE(proposal->close_second);
  EXPECT_EQ(proposal->problem, "");
  ASSERT_EQ(proposal->trials.size(), 2u);
  EXPECT_EQ(proposal->trials[0].scans, proposal->trials[1].scans) << "the same ones";
}

TEST_F(ProposalTest, TwoRobotsInOneLogAreSaid) {
  const auto drive = [&](const std::string& robot, double turn) {
    DriveInRoom(
        {.sign = -1}, turn,
        [&](const TimedPose& pose) { Add(robot + "_POSE", pose.utime, Encode(PoseMessage(pose))); },
        [&](const RangeReadings& readings) {
          Add(robot + "_LIDAR", readings.utime, Encode(LidarMessage(readings)));
        });
  };
  drive("one", 1);
  drive("two", -0.6);
  const auto proposal = Propose(survey_, {});
  ASSERT_TRUE(absl::IsInvalidArgument(proposal.status())) << proposal.status();
  EXPECT_NE(proposal.status().message().find("two robots"), std::string::npos);
  config::Config given;
  given.add_scan()->set_channel("two_LIDAR");
  const auto of_one = Propose(survey_, given);
  ASSERT_TRUE(of_one.ok()) << of_one.status();
  EXPECT_EQ(of_one->pose, "two_POSE");
}

TEST_F(ProposalTest, ProposesWhatDiffersFromThePreset) {
  Drive({.sign = 1, .stamp_late_s = 0.4});
  const auto proposal = Propose(survey_, {});
  ASSERT_TRUE(proposal.ok()) << proposal.status();
  // Told as michigan_2017, whose sign is the other one.
  EXPECT_EQ(proposal->scan_flags,
            std::vector<std::string>{"LIDAR:michigan_2017,bearing_sign=1,time_offset_ms=-400"});
}

TEST_F(ProposalTest, PosesOfAnotherClockAreBroughtToTheScans) {
  Drive({.sign = -1, .duration_s = 0.15, .beam_times = true}, seconds(1'000'000));
  config::Config given;
  given.set_pose("ODOMETRY");
  const auto proposal = Propose(survey_, given);
  ASSERT_TRUE(proposal.ok()) << proposal.status();
  EXPECT_EQ(proposal->scan_flags,
            std::vector<std::string>{"LIDAR:michigan_2014,time_offset_ms=1000000000"});
  const std::vector<std::string> remarks = Remarks(survey_);
  ASSERT_EQ(remarks.size(), 1u);
  EXPECT_EQ(
      remarks[0],
      "ODOMETRY: its stamps are 1000000.0 s ahead of those of LIDAR that are received with them: "
      "another clock");
}

TEST_F(ProposalTest, AClockThatIsNonsenseIsNotMadeAnOption) {
  for (const Utime received : {Utime::min(), Utime::max()}) {
    Survey survey;
    survey.Add(received, "LASER", Encode(PlanarLidarMessage(Utime(0), {1, 2}, 0, 1)));
    survey.Add(Utime(0), "POSE", Encode(PoseMessage({})));
    const auto proposal = Propose(survey, {});
    ASSERT_TRUE(proposal.ok()) << proposal.status();
    EXPECT_EQ(proposal->scan_flags, std::vector<std::string>{"LASER"});
  }
}

TEST_F(ProposalTest, SingleOddStampsDoNotMakeAnotherClock) {
  Drive({.sign = -1, .duration_s = 0.15, .beam_times = true});
  Add("SLAM", seconds(170), Encode(PoseMessage({seconds(400'000), {}})));
  RangeReadings readings;
  readings.utime = seconds(4000);
  Add("LIDAR", seconds(170), Encode(LidarMessage(readings)));
  survey_.Add(Utime(1LL << 62), "SLAM", Encode(PoseMessage({seconds(171), {}})));
  const auto proposal = Propose(survey_, {});
  ASSERT_TRUE(proposal.ok()) << proposal.status();
  EXPECT_EQ(proposal->pose, "SLAM");
  EXPECT_EQ(proposal->scan_flags, std::vector<std::string>{"LIDAR"});
}

TEST_F(ProposalTest, PosesOfAFewSecondsDoNotWinByHavingFewScans) {
  DriveInRoom(
      {.sign = -1, .duration_s = 0.15, .beam_times = true}, 1,
      [&](const TimedPose& pose) {
        Add("SLAM", pose.utime, Encode(PoseMessage(pose)));
        if (pose.utime < seconds(106)) Add("SHORT", pose.utime, Encode(PoseMessage(pose)));
      },
      [&](const RangeReadings& scan) { Add("LIDAR", scan.utime, Encode(LidarMessage(scan))); });
  const auto proposal = Propose(survey_, {});
  ASSERT_TRUE(proposal.ok()) << proposal.status();
  EXPECT_EQ(proposal->pose, "SLAM");
}

TEST_F(ProposalTest, ARobotThatDoesNotTurnLeavesTheChoiceToItsMaster) {
  Drive({.beam_times = true}, Utime(0), 0);
  const auto open = Propose(survey_, {});
  EXPECT_NE(std::string(open.status().message()).find("--pose SLAM"), std::string::npos)
      << open.status();
  config::Config given;
  given.set_pose("SLAM");
  const auto chosen = Propose(survey_, given);
  ASSERT_TRUE(chosen.ok()) << chosen.status();
  EXPECT_FALSE(chosen->trials[0].flags);
  EXPECT_EQ(chosen->scan_flags, std::vector<std::string>{"LIDAR"});
}

TEST_F(ProposalTest, SeveralScanChannelsGetTheirOwnFlags) {
  Drive({.sign = -1, .duration_s = 0.15, .beam_times = true});
  DriveInRoom(
      {.yaw_rad = M_PI, .duration_s = 0}, 1, [](const TimedPose&) {},
      [&](const RangeReadings& readings) {
        Add("REAR", readings.utime,
            Encode(PlanarLidarMessage(readings.utime, readings.ranges_m, 0,
                                      readings.bearings_rad[1])));
      });
  const auto proposal = Propose(survey_, {});
  ASSERT_TRUE(proposal.ok()) << proposal.status();
  EXPECT_EQ(proposal->pose, "SLAM");
  EXPECT_EQ(proposal->scan_flags, (std::vector<std::string>{"LIDAR", "REAR:bot_core,yaw_deg=180"}));
}

TEST_F(ProposalTest, AnOffsetBeyondThoseThatWereTriedIsSearchedOn) {
  Drive({.sign = -1, .stamp_late_s = 1.5});
  config::Config given;
  given.set_pose("SLAM");
  const auto first = Propose(survey_, given);
  ASSERT_TRUE(first.ok()) << first.status();
  EXPECT_NE(first->problem.find("LIDAR: its scans and the poses of SLAM"), std::string::npos)
      << first->problem;
  ASSERT_EQ(first->scan_flags.size(), 1u);
  *given.add_scan() = *ParseScanFlag(first->scan_flags[0]);
  const auto second = Propose(survey_, given);
  ASSERT_TRUE(second.ok()) << second.status();
  EXPECT_EQ(second->problem, "");
  EXPECT_NEAR(ParseScanFlag(second->scan_flags[0])->time_offset_ms(), -1500, 5)
      << second->scan_flags[0];
}

TEST_F(ProposalTest, TheTransformOnAChannelIsWhereTheSensorSits) {
  const double yaw_rad = M_PI / 6;
  Drive({.sign = -1, .yaw_rad = yaw_rad, .duration_s = 0.15, .beam_times = true});
  config::Config given;
  *given.add_scan() = *ParseScanFlag("LIDAR,extrinsics_channel=MOUNT");
  const auto without = Propose(survey_, given);
  ASSERT_TRUE(without.ok()) << without.status();
  ASSERT_FALSE(without->cautions.empty());
  EXPECT_NE(without->cautions[0].find("no transform (bot_core.rigid_transform_t) came on MOUNT"),
            std::string::npos);

  const auto add_mount = [&](double about_z_rad) {
    bot_core::rigid_transform_t transform{};
    transform.quat[0] = std::cos(about_z_rad / 2);
    transform.quat[3] = std::sin(about_z_rad / 2);
    Add("MOUNT", seconds(200), Encode(transform));
  };
  add_mount(yaw_rad);
  add_mount(0);  // the first counts
  const auto with = Propose(survey_, given);
  ASSERT_TRUE(with.ok()) << with.status();
  EXPECT_EQ(with->pose, "SLAM");
  EXPECT_EQ(with->cautions, std::vector<std::string>());
  EXPECT_EQ(with->scan_flags,
            std::vector<std::string>{"LIDAR:michigan_2014,extrinsics_channel=MOUNT"});
  EXPECT_LT(with->trials[1].flags->spread_given, 0.8 * without->trials[1].flags->spread_given);
}

TEST_F(ProposalTest, ATransformThatIsTurnedByAQuarterIsSaid) {
  Drive({.sign = -1, .yaw_rad = M_PI / 2, .duration_s = 0.15, .beam_times = true});
  bot_core::rigid_transform_t none{};
  none.quat[0] = 1;
  Add("MOUNT", seconds(200), Encode(none));
  config::Config given;
  *given.add_scan() = *ParseScanFlag("LIDAR,extrinsics_channel=MOUNT");
  const auto proposal = Propose(survey_, given);
  ASSERT_TRUE(proposal.ok()) << proposal.status();
  ASSERT_EQ(proposal->cautions.size(), 1u);
  EXPECT_NE(proposal->cautions[0].find("turned by 90 degrees"), std::string::npos)
      << proposal->cautions[0];
}

TEST_F(ProposalTest, ACloseCallBetweenPosesIsCalledOne) {
  DriveInRoom(
      {.sign = -1, .duration_s = 0.15, .beam_times = true}, 1,
      [&](const TimedPose& pose) {
        Add("SLAM", pose.utime, Encode(PoseMessage(pose)));
        TimedPose noisy = pose;
        noisy.world_T_robot.yaw_rad +=
            0.003 * std::sin(1e-4 * static_cast<double>(pose.utime.count()));
        Add("SLAM_NOISY", pose.utime, Encode(PoseMessage(noisy)));
      },
      [&](const RangeReadings& scan) { Add("LIDAR", scan.utime, Encode(LidarMessage(scan))); });
  const auto proposal = Propose(survey_, {});
  ASSERT_TRUE(proposal.ok()) << proposal.status();
  ASSERT_EQ(proposal->cautions.size(), 1u);
  EXPECT_NE(proposal->cautions[0].find("a close call: of"), std::string::npos);
  EXPECT_NE(proposal->cautions[0].find("SLAM_NOISY"), std::string::npos);
  ASSERT_TRUE(proposal->close_second);
  EXPECT_EQ(proposal->close_second->pose, "SLAM_NOISY");
  EXPECT_EQ(proposal->close_second->scan_flags, std::vector<std::string>{"LIDAR"});
}

TEST_F(ProposalTest, AChoiceByFewScansIsCalledACloseOne) {
  DriveInRoom(
      {.sign = -1, .duration_s = 0.15, .beam_times = true}, 1,
      [&](const TimedPose& pose) {
        Add("SLAM", pose.utime, Encode(PoseMessage(pose)));
        TimedPose drifting = pose;
        drifting.world_T_robot.yaw_rad *= 1.2;
        Add("ODOMETRY", pose.utime, Encode(PoseMessage(drifting)));
      },
      [&](const RangeReadings& scan) {
        if (scan.utime < seconds(106)) Add("LIDAR", scan.utime, Encode(LidarMessage(scan)));
      });
  const auto proposal = Propose(survey_, {});
  ASSERT_TRUE(proposal.ok()) << proposal.status();
  EXPECT_EQ(proposal->pose, "SLAM");
  ASSERT_EQ(proposal->cautions.size(), 1u);
  EXPECT_NE(proposal->cautions[0].find("a close call: of"), std::string::npos);
}

TEST_F(ProposalTest, WithoutScansOrPosesItSaysWhatIsRead) {
  EXPECT_TRUE(absl::IsInvalidArgument(Propose(survey_, {}).status()));
  Add("POSE", Utime(0), Encode(PoseMessage({})));
  const absl::Status status = Propose(survey_, {}).status();
  EXPECT_NE(std::string(status.message()).find("planar_lidar_t"), std::string::npos) << status;
}

TEST_F(ProposalTest, OddThingsAreRemarkedOn) {
  Drive({});
  Add("SLAM", seconds(200), Encode(PoseMessage({seconds(170), {}})));
  Add("SLAM", seconds(200), Encode(PoseMessage({seconds(170), {}})));
  Add("SLAM", seconds(200), {1, 2, 3});
  std::string all;
  for (const std::string& remark : Remarks(survey_)) all += remark + "\n";
  EXPECT_NE(all.find("SLAM: 1 of 3003 messages cannot be used, the first: 3 bytes"),
            std::string::npos)
      << all;
  EXPECT_NE(all.find("SLAM: 1 of 3003 messages repeat the time"), std::string::npos) << all;
  EXPECT_NE(all.find("SLAM: a gap of 10.0 s"), std::string::npos) << all;
  EXPECT_NE(all.find("LIDAR: its beam times are all the same"), std::string::npos) << all;
}

// Poses that are heard late are of the same clock.
TEST_F(ProposalTest, LatePosesAreNoOtherClock) {
  DriveInRoom(
      {.sign = 1}, 1,
      [&](const TimedPose& pose) {
        survey_.Add(pose.utime + milliseconds(1200), "SLAM", Encode(PoseMessage(pose)));
      },
      [&](const RangeReadings& scan) {
        survey_.Add(scan.utime, "LIDAR", Encode(LidarMessage(scan)));
      });
  config::Config given;
  *given.add_scan() = *ParseScanFlag("LIDAR:bot_core,scan_duration_ms=100");
  const auto proposal = Propose(survey_, given);
  ASSERT_TRUE(proposal.ok()) << proposal.status();
  EXPECT_EQ(proposal->trials[0].clock_offset, Utime(0));
  EXPECT_EQ(proposal->trials[0].flags->options.time_offset, Utime(0));
}

// The robot does not turn, so nothing tells one clock from another.
TEST_F(ProposalTest, AnOffsetBetweenClocksThatCannotBeJudgedIsNotProposed) {
  DriveInRoom(
      {}, 0,
      [&](const TimedPose& pose) {
        survey_.Add(pose.utime + milliseconds(1200), "SLAM", Encode(PoseMessage(pose)));
      },
      [&](const RangeReadings& scan) {
        survey_.Add(scan.utime, "LIDAR", Encode(LidarMessage(scan)));
      });
  const auto proposal = Propose(survey_, {});
  ASSERT_TRUE(proposal.ok()) << proposal.status();
  ASSERT_EQ(proposal->trials.size(), 1u);
  EXPECT_FALSE(proposal->trials[0].flags);
  EXPECT_EQ(proposal->scan_flags, std::vector<std::string>{"LIDAR"});
}

TEST_F(ProposalTest, AnOffsetBetweenClocksIsProposedWhereNothingElseHasPoses) {
  Drive({}, seconds(1'000'000), 0);
  config::Config given;
  given.set_pose("ODOMETRY");
  const auto proposal = Propose(survey_, given);
  ASSERT_TRUE(proposal.ok()) << proposal.status();
  ASSERT_EQ(proposal->trials.size(), 1u);
  EXPECT_FALSE(proposal->trials[0].flags);
  ASSERT_EQ(proposal->scan_flags.size(), 1u);
  EXPECT_NEAR(ParseScanFlag(proposal->scan_flags[0])->time_offset_ms(), 1e9, 200)
      << proposal->scan_flags[0];
}

TEST_F(ProposalTest, CellsAsGivenAreThoseOfTheFlagsGiven) {
  const auto drive = [](Utime scan_clock, double no_return_m) {
    Survey survey;
    DriveInRoom(
        {.sign = -1}, 1,
        [&](const TimedPose& pose) { survey.Add(pose.utime, "SLAM", Encode(PoseMessage(pose))); },
        [&](RangeReadings scan) {
          const Utime received = scan.utime;
          scan.utime += scan_clock;
          if (no_return_m > 0) {
            for (size_t k = 0; k < scan.ranges_m.size(); k += 5) {
              scan.ranges_m[k] = static_cast<float>(no_return_m);
            }
          }
          survey.Add(received, "LIDAR", Encode(LidarMessage(scan)));
        });
    const auto proposal = Propose(survey, {});
    EXPECT_TRUE(proposal.ok()) << proposal.status();
    return proposal->trials.at(0);
  };
  // Readings of no return lie in cells of their own, unless they are left out.
  const FlagTrial piled_up = drive(Utime(0), 29.95);
  ASSERT_TRUE(piled_up.spread_as_given);
  EXPECT_GT(*piled_up.spread_as_given, 1.2 * piled_up.flags->spread_given);
  EXPECT_FALSE(drive(seconds(1'000'000), 0).spread_as_given) << "nothing is mapped";
  const FlagTrial honest = drive(Utime(0), 0);
  EXPECT_EQ(honest.spread_as_given, honest.flags->spread_given);
}

TEST_F(ProposalTest, SharperPosesThanThoseChosenAreNamed) {
  Drive({.sign = -1, .duration_s = 0.15, .beam_times = true});
  config::Config chosen;
  chosen.add_scan()->set_channel("LIDAR");
  chosen.set_pose("ODOMETRY");
  EXPECT_EQ(SharperPoses(survey_, chosen)
                .find("ODOMETRY: the map is sharper with the poses of SLAM: hits lie in"),
            0u)
      << SharperPoses(survey_, chosen);
  chosen.set_pose("SLAM");
  EXPECT_EQ(SharperPoses(survey_, chosen), "");
}

TEST_F(ProposalTest, WhatCannotBeJudgedIsNotProposed) {
  int n = 0;
  DriveInRoom(
      {}, 1,
      [&](const TimedPose& pose) {
        TimedPose jumping = pose;
        if (++n % 2 == 0) jumping.world_T_robot.position_m.x() += 300;
        Add("SLAM", pose.utime, Encode(PoseMessage(jumping)));
      },
      [&](const RangeReadings& scan) { Add("LIDAR", scan.utime, Encode(LidarMessage(scan))); });
  const auto jumping = Propose(survey_, {});
  EXPECT_NE(std::string(jumping.status().message()).find("do two localisations publish on it?"),
            std::string::npos)
      << jumping.status();

  Survey millimetres;
  DriveInRoom(
      {}, 1,
      [&](const TimedPose& pose) {
        millimetres.Add(pose.utime, "SLAM", Encode(PoseMessage(pose)));
      },
      [&](RangeReadings scan) {
        for (float& range_m : scan.ranges_m) range_m *= 1000;
        millimetres.Add(scan.utime, "LIDAR", Encode(LidarMessage(scan)));
      });
  EXPECT_NE(std::string(Propose(millimetres, {}).status().message()).find("millimetres"),
            std::string::npos);
}

}  // namespace splinemap::proposal_test
