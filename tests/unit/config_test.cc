#include "lib/config/config.h"

#include <fmt/format.h>
#include <gtest/gtest.h>

#include <fstream>
#include <numbers>

#include "lib/config/checked_text.h"
#include "tests/support/temporary_directory.h"

namespace splinemap::config_test {

using std::chrono::milliseconds;

std::string ErrorOf(const std::string& text) {
  config::Config config;
  return std::string(ParseCheckedText(text, "file", &config).message());
}

TEST(CheckedTextTest, ErrorsNameLineAndColumn) {
  EXPECT_EQ(ErrorOf("name: \"a\"\npose: 3\n").substr(0, 9), "file:2:7:");
  EXPECT_EQ(ErrorOf("name: \"a\"\n  nmae: \"b\"\n").substr(0, 7), "file:2:");
  EXPECT_EQ(ErrorOf("scan {\n  bearing_sing: 1\n}"),
            "file:2:15: Message type \"splinemap.config.Scan\" has no field named "
            "\"bearing_sing\". (did you mean bearing_sign?)");
  EXPECT_EQ(ErrorOf("method {\n  knot_interval_m: 0\n}"),
            "file:2:3: knot_interval_m is 0, allowed: 0.005 .. 10");
}

TEST(CheckedTextTest, ValuesOutOfRangeAndNotFiniteAreErrors) {
  for (const char* bad :
       {"method { knot_interval_m: nan }", "method { knot_interval_m: inf }",
        "method { kappa_free: 0.3 }", "scan { bearing_sign: 0 }", "scan { no_return: \"maybe\" }",
        "scan { preset: \"ros\" }", "service { max_queued_mb: 0 }", "scan { x_m: -inf }"}) {
    EXPECT_NE(ErrorOf(bad), "") << bad;
  }
  EXPECT_EQ(ErrorOf("scan { channel: \"A\" bearing_sign: -1 } scan { channel: \"B\" }"), "");
}

TEST(CheckedTextTest, AllErrorsAreReportedAtOnce) {
  const std::string errors = ErrorOf("method { kappa_hit: 9 }\nscan { range_max_m: -1 }");
  EXPECT_NE(errors.find("kappa_hit"), std::string::npos);
  EXPECT_NE(errors.find("range_max_m"), std::string::npos);
}

TEST(CheckedTextTest, TheDocumentedPrintParsesToTheSame) {
  config::Config config;
  *config.add_scan() = *ParseScanFlag("LIDAR:michigan_2014,x_m=0.1");
  *config.add_scan() = *ParseScanFlag("REAR");
  config.set_pose("POSE \"quoted\"");
  config.mutable_method()->set_kappa_hit(1.5);
  config::Config parsed;
  ASSERT_TRUE(ParseCheckedText(PrintDocumented(config), "printed", &parsed).ok());
  // Groups that were not set are printed empty.
  config.mutable_timing();
  config.mutable_service();
  EXPECT_EQ(parsed.SerializeAsString(), config.SerializeAsString()) << PrintDocumented(config);
}

TEST(ScanFlagTest, ReadsChannelPresetAndOptions) {
  const auto scan = ParseScanFlag("LIDAR:michigan_2017,time_offset_ms=-200,no_return=free");
  ASSERT_TRUE(scan.ok()) << scan.status();
  EXPECT_EQ(scan->channel(), "LIDAR");
  EXPECT_EQ(scan->preset(), "michigan_2017");
  EXPECT_EQ(scan->time_offset_ms(), -200);
  EXPECT_EQ(ParseScanFlag("LIDAR:x_m=0.25")->x_m(), 0.25);
  EXPECT_EQ(ParseScanFlag("LIDAR,x_m=0.25")->channel(), "LIDAR");
  EXPECT_EQ(ParseScanFlag("LIDAR,x_m=0.25")->x_m(), 0.25);
  EXPECT_EQ(ParseScanFlag("LIDAR")->preset(), "auto");
}

TEST(ScanFlagTest, WrongFlagsSayWhatIsWrong) {
  const auto error = [](const char* flag) {
    return std::string(ParseScanFlag(flag).status().message());
  };
  EXPECT_NE(error("LIDAR:michigan").find("michigan_2014"), std::string::npos);
  EXPECT_NE(error("LIDAR:x=1").find("x_m"), std::string::npos);
  EXPECT_NE(error("LIDAR:yaw=1").find("(did you mean yaw_deg?)"), std::string::npos);
  EXPECT_NE(error("LIDAR:x_m=far"), "");
  EXPECT_NE(error("LIDAR:x_m=1e9"), "");
  EXPECT_NE(error("LIDAR:bot_core,mbot_2024"), "");
  EXPECT_NE(error(":bot_core"), "");
  EXPECT_NE(error("LIDAR,bot_core"), "");
}

TEST(PresetTest, ExplicitValuesWinOverThePreset) {
  const auto scan = ParseScanFlag("LIDAR:michigan_2014,bearing_sign=1");
  const SensorOptions options = SensorOptionsOf(*scan, scan->preset());
  EXPECT_EQ(options.bearing_sign, 1);
  EXPECT_TRUE(options.use_beam_times);
}

TEST(ParseScanFlagTest, MasksAddUp) {
  const auto scan = ParseScanFlag("LIDAR:bot_core,mask=170..-170,mask=10..20,every_nth_beam=3");
  ASSERT_TRUE(scan.ok()) << scan.status();
  const SensorOptions options = SensorOptionsOf(*scan, scan->preset());
  ASSERT_EQ(options.masks.size(), 2u);
  EXPECT_NEAR(options.masks[0].from_rad, 170 * std::numbers::pi / 180, 1e-12);
  EXPECT_NEAR(options.masks[0].span_rad, 20 * std::numbers::pi / 180, 1e-12);
  EXPECT_NEAR(options.masks[1].span_rad, 10 * std::numbers::pi / 180, 1e-12);
  EXPECT_EQ(options.every_nth_beam, 3);
}

TEST(ScanFlagTest, IsWrittenAsItIsRead) {
  for (const char* flag : {"LIDAR", "LIDAR:mbot_2024", "LIDAR,x_m=0.25",
                           "A B:bot_core,no_return=free,mask=1..2,mask=3..4",
                           "LIDAR:bot_core,time_offset_ms=-1487296512345,beam_times=true"}) {
    const auto scan = ParseScanFlag(flag);
    ASSERT_TRUE(scan.ok()) << scan.status();
    EXPECT_EQ(ParseScanFlag(ScanFlagOf(*scan))->SerializeAsString(), scan->SerializeAsString());
  }
}

TEST(CheckConfigTest, MasksAreRangesOfDegrees) {
  for (const char* mask :
       {"", "10", "10..", "10..10", "a..b", "0..400", "nan..10", "1..2..3", "-180..180"}) {
    config::Config config;
    config.set_pose("POSE");
    config.add_scan()->set_channel("LIDAR");
    config.mutable_scan(0)->add_mask(mask);
    EXPECT_FALSE(CheckConfig(config).ok()) << mask;
    config.mutable_scan(0)->set_mask(0, "-180..179");
    EXPECT_TRUE(CheckConfig(config).ok());
  }
}

TEST(CheckConfigTest, WhatIsToBeForgottenHasToBeKept) {
  config::Config config;
  config.set_pose("POSE");
  config.add_scan()->set_channel("LASER");
  config.mutable_service()->set_forget_after_min(5);
  EXPECT_TRUE(CheckConfig(config).ok());
  config.mutable_service()->set_max_archive_mb(0);
  EXPECT_TRUE(absl::IsInvalidArgument(CheckConfig(config)));
}

TEST(CheckConfigTest, AFrameIsThreeNumbers) {
  config::Config config;
  config.set_pose("POSE");
  config.add_scan()->set_channel("LASER");
  config.set_frame("2.5,-1,90");
  ASSERT_TRUE(CheckConfig(config).ok());
  const Pose2 frame = FrameOf(config).ToPose();
  EXPECT_NEAR(frame.position_m.x(), 2.5, 1e-6);
  EXPECT_NEAR(frame.position_m.y(), -1, 1e-6);
  EXPECT_NEAR(frame.yaw_rad, std::numbers::pi / 2, 1e-9);
  for (const char* bad : {"1,2", "1,2,3,4", "a,2,3", "nan,0,0", "0,1e9,0", "0,0,400", " "}) {
    config.set_frame(bad);
    EXPECT_FALSE(CheckConfig(config).ok()) << bad;
  }
}

TEST(CheckConfigTest, ExtrinsicsComeFromOnePlace) {
  config::Config config;
  config.set_pose("POSE");
  config.add_scan()->set_channel("LIDAR");
  config.add_scan()->set_channel("REAR");
  config.mutable_scan(0)->set_extrinsics_channel("MOUNT");
  config.mutable_scan(1)->set_extrinsics_channel("MOUNT");
  EXPECT_TRUE(CheckConfig(config).ok()) << "one may serve two";
  config.mutable_scan(0)->set_yaw_deg(3);
  EXPECT_FALSE(CheckConfig(config).ok()) << "from the channel and the configuration";
  config.mutable_scan(0)->clear_yaw_deg();
  config.mutable_scan(0)->set_extrinsics_channel("REAR");
  EXPECT_FALSE(CheckConfig(config).ok()) << "a channel of scans";
}

TEST(PresetTest, EachPresetParses) {
  EXPECT_EQ(PresetNames().size(), 4u);
  config::Scan scan;
  EXPECT_EQ(SensorOptionsOf(scan, "bot_core").bearing_sign, 1);
  EXPECT_EQ(SensorOptionsOf(scan, "michigan_2014").bearing_sign, -1);
  EXPECT_EQ(SensorOptionsOf(scan, "michigan_2017").time_offset, milliseconds(-150));
  EXPECT_EQ(SensorOptionsOf(scan, "mbot_2024").scan_duration, milliseconds(-100));
}

TEST(PresetTest, IsToldFromTheFirstMessage) {
  RangeReadings readings;
  readings.utime = milliseconds(1000);
  EXPECT_EQ(DetectPreset(true, readings), "bot_core");
  readings.beam_utimes = {milliseconds(1000), milliseconds(1150)};
  EXPECT_EQ(DetectPreset(false, readings), "michigan_2014");
  readings.beam_utimes = {milliseconds(900), milliseconds(1000)};
  EXPECT_EQ(DetectPreset(false, readings), "mbot_2024");
  readings.beam_utimes = {milliseconds(1001), milliseconds(1001)};
  EXPECT_EQ(DetectPreset(false, readings), "michigan_2017");
  readings.beam_utimes = {Utime::min(), Utime::max()};
  EXPECT_EQ(DetectPreset(false, readings), "michigan_2017") << "uninitialised";
  readings.beam_utimes = {milliseconds(1001)};
  EXPECT_EQ(DetectPreset(false, readings), std::nullopt) << "a lidar that spins up";
}

TEST(CheckConfigTest, WantsAScanAndAPoseChannel) {
  config::Config config;
  EXPECT_NE(std::string(CheckConfig(config).message()).find("--scan"), std::string::npos);
  config.add_scan()->set_channel("LASER");
  EXPECT_NE(std::string(CheckConfig(config).message()).find("--pose"), std::string::npos);
  config.set_pose("POSE");
  EXPECT_TRUE(CheckConfig(config).ok());
}

TEST(CheckConfigTest, NamesAndChannelsHaveToFitFilesAndLcm) {
  config::Config config;
  config.set_pose("POSE");
  config.add_scan()->set_channel("LASER");
  for (const char* bad : {"a/b", "B\xfcro", "two words", "line\n"}) {
    config.set_name(bad);
    EXPECT_FALSE(CheckConfig(config).ok()) << bad;
  }
  config.set_name("robot-1.lab_2");
  EXPECT_TRUE(CheckConfig(config).ok());
  config.mutable_scan(0)->set_channel(std::string(64, 'A'));
  EXPECT_FALSE(CheckConfig(config).ok());
  config.mutable_scan(0)->set_channel(std::string(63, 'A'));
  EXPECT_TRUE(CheckConfig(config).ok());
  config.set_channel_prefix(std::string(39, 'A'));
  EXPECT_FALSE(CheckConfig(config).ok()) << "_REPLIES_ and 16 digits";
  config.set_channel_prefix(std::string(38, 'A'));
  EXPECT_TRUE(CheckConfig(config).ok());
}

TEST(CheckConfigTest, RefusesWhatCannotWork) {
  config::Config config;
  config.set_pose("POSE");
  config::Scan& scan = *config.add_scan();
  scan.set_channel("POSE");
  EXPECT_FALSE(CheckConfig(config).ok()) << "one channel for two purposes";
  scan.set_channel("LASER");
  scan.set_range_max_m(1000);
  EXPECT_FALSE(CheckConfig(config).ok()) << "20,000 knot intervals";
  scan.set_range_max_m(0.2);
  scan.set_range_min_m(0.2);
  EXPECT_FALSE(CheckConfig(config).ok()) << "no range left";
}

TEST(CheckedTextTest, AllowsJustTheStrengthsThatTheSumsAreSafeFor) {
  const auto is_allowed = [](const std::string& field, double value) {
    return ErrorOf(fmt::format("method {{ {}: {} }}", field, value)).empty();
  };
  EXPECT_TRUE(is_allowed("kappa_hit", kMaxKappaHit));
  EXPECT_FALSE(is_allowed("kappa_hit", kMaxKappaHit + 0.01));
  EXPECT_TRUE(is_allowed("kappa_free", kMinKappaFree));
  EXPECT_FALSE(is_allowed("kappa_free", kMinKappaFree - 0.01));
  EXPECT_TRUE(is_allowed("free_sample_spacing_knots", kMinFreeSampleSpacingKnots));
  EXPECT_FALSE(is_allowed("free_sample_spacing_knots", kMinFreeSampleSpacingKnots - 0.01));
}

TEST(LoadConfigTest, NamesTheFile) {
  const TemporaryDirectory directory;
  EXPECT_TRUE(absl::IsNotFound(LoadConfig(directory.File("none")).status()));
  std::ofstream(directory.File("bad")) << "pose: \"P\"\nscans {}\n";
  const auto status = LoadConfig(directory.File("bad")).status();
  EXPECT_NE(std::string(status.message()).find("bad:2:"), std::string::npos) << status;
}

TEST(DefaultsTest, AreThoseThatWereMeasured) {
  const config::Config config;
  EXPECT_EQ(MapOptionsOf(config.method()).knot_interval_m, 0.05);
  EXPECT_EQ(MapOptionsOf(config.method()).limits.min, -64 * kUnitsPerLogOdds);
  EXPECT_EQ(MapOptionsOf(config.method()).limits.max, 64 * kUnitsPerLogOdds);
  const BeamModelOptions beam = BeamModelOptionsOf(config.method());
  EXPECT_EQ(beam.update, BeamUpdate::kSignedDistance);
  EXPECT_EQ(beam.kappa_hit, 0.9);
  EXPECT_EQ(beam.kappa_free, -0.3);
  EXPECT_EQ(beam.free_sample_spacing_knots, 1.41);
  const SensorOptions sensor = SensorOptionsOf({}, "bot_core");
  EXPECT_EQ(sensor.range_min_m, 0.05);
  EXPECT_EQ(sensor.range_max_m, 30);
  EXPECT_FALSE(sensor.no_return_is_free);
}

TEST(MethodPresetTest, PaperStandsForThePapersValues) {
  config::Method method;
  method.set_preset("paper");
  EXPECT_EQ(MapOptionsOf(method), MapOptions());
  const BeamModelOptions beam = BeamModelOptionsOf(method);
  EXPECT_EQ(beam.update, BeamUpdate::kPaperSamples);
  EXPECT_EQ(beam.kappa_hit, 0.9);
  EXPECT_EQ(beam.kappa_free, -0.3);
  method.set_kappa_free(-0.2);
  EXPECT_EQ(BeamModelOptionsOf(method).kappa_free, -0.2) << "what is set goes first";
}

}  // namespace splinemap::config_test
