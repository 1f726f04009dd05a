#include "lib/wire/decode.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <limits>
#include <new>
#include <random>
#include <vector>

#include "lcmtypes/bot_core/planar_lidar_t.hpp"
#include "lcmtypes/bot_core/pose_t.hpp"
#include "lcmtypes/bot_core/rigid_transform_t.hpp"
#include "lcmtypes/michigan/lidar_t.hpp"
#include "lcmtypes/michigan/pose_xyt_t.hpp"
#include "lcmtypes/splinemap/layer_digest_t.hpp"
#include "lcmtypes/splinemap/layer_listing_t.hpp"
#include "lcmtypes/splinemap/layer_pull_t.hpp"
#include "lcmtypes/splinemap/layer_updates_t.hpp"
#include "lcmtypes/splinemap/likelihoods_request_t.hpp"
#include "lcmtypes/splinemap/points_reply_t.hpp"
#include "lcmtypes/splinemap/rays_request_t.hpp"
#include "lcmtypes/splinemap/status_t.hpp"
#include "lcmtypes/splinemap/sweep_t.hpp"
#include "lcmtypes/splinemap/sweeps_request_t.hpp"
#include "lcmtypes/splinemap/tile_update_t.hpp"
#include "lib/replication/protocol.h"
#include "lib/wire/encode.h"
#include "lib/wire/sensor_messages.h"
#include "splinemap/layer.h"

// Sees what decoding allocates.
static size_t largest_allocation = 0;
[[gnu::noinline]] void* operator new(size_t size) {
  largest_allocation = std::max(largest_allocation, size);
  if (void* memory = std::malloc(size)) return memory;
  throw std::bad_alloc();
}
[[gnu::noinline]] void operator delete(void* memory) noexcept { std::free(memory); }
[[gnu::noinline]] void operator delete(void* memory, size_t) noexcept { std::free(memory); }

namespace splinemap::decode_test {

michigan::lidar_t MichiganScan() {
  michigan::lidar_t message;
  message.utime = 5'000'000;
  message.num_ranges = 2;
  message.ranges = {1, 2};
  message.thetas = {0, 3};
  message.times = {5'000'000, 5'100'000};
  message.intensities = {7, 8};
  return message;
}

// Turned by `angle_rad` about one axis: 0 is x, 1 is y, 2 is z.
bot_core::rigid_transform_t Turned(int axis, double angle_rad) {
  bot_core::rigid_transform_t transform{};
  transform.trans[0] = 0.1;
  transform.trans[1] = -0.2;
  transform.quat[0] = std::cos(angle_rad / 2);
  transform.quat[1 + axis] = std::sin(angle_rad / 2);
  return transform;
}

status_t Status() {
  status_t status{};
  status.utime = 1;
  status.name = "robot";
  status.version = "1";
  status.num_drop_reasons = 2;
  status.drop_reasons = {"late_scan", "overload"};
  status.drop_counts = {3, 4};
  status.num_problems = 1;
  status.problems = {"time_jump"};
  status.problem_counts = {2};
  status.last_problem = "none";
  return status;
}

sweeps_request_t Sweeps() {
  sweeps_request_t request{};
  request.header.client = 1;
  request.header.id = 2;
  request.header.query = 3;
  request.header.daemon_nonce = -4;
  request.num_sweeps = 2;
  request.sweeps.resize(2);
  for (sweep_t& sweep : request.sweeps) {
    sweep.radius_m = 0.5;
    sweep.num_vertices = 1;
    sweep.x_m = {1};
    sweep.y_m = {2};
  }
  return request;
}

points_reply_t PointsReply() {
  points_reply_t reply{};
  reply.header.id = 7;
  reply.header.name = "robot";
  reply.num_points = 1;
  reply.log_odds = reply.gradient_x_per_m = reply.gradient_y_per_m = {1};
  reply.known = {1};
  reply.num_hessians = 1;
  reply.hessian_xx_per_m2 = reply.hessian_xy_per_m2 = reply.hessian_yy_per_m2 = {1};
  return reply;
}

likelihoods_request_t Likelihoods() {
  likelihoods_request_t request{};
  request.num_hits = request.num_poses = 1;
  request.hit_x_m = request.hit_y_m = request.x_m = request.y_m = request.yaw_rad = {1};
  return request;
}

std::vector<std::vector<uint8_t>> OneOfEach() {
  bot_core::planar_lidar_t planar = PlanarLidarMessage(Utime(1), {1, 2, 3}, -1, 0.5);
  planar.nintensities = 1;  // may differ from nranges
  planar.intensities = {9};
  michigan::pose_xyt_t pose{};
  return {Encode(planar),   Encode(MichiganScan()), Encode(PoseMessage({Utime(1), {}})),
          Encode(pose),     Encode(Turned(2, 1)),   Encode(Status()),
          Encode(Sweeps()), Encode(PointsReply()),  Encode(Likelihoods())};
}

// Whatever the bytes: no crash, no exception, no memory beyond their size.
void DecodeAll(const std::vector<uint8_t>& bytes) {
  (void)DecodeScan(bytes);
  (void)DecodePose(bytes);
  (void)DecodeSensorMount(bytes);
  (void)Decode<status_t>(bytes);
  (void)Decode<sweeps_request_t>(bytes);
  (void)Decode<points_reply_t>(bytes);
  (void)Decode<likelihoods_request_t>(bytes);
}

TEST(DecodeTest, FingerprintsAreThoseInUse) {
  EXPECT_EQ(FingerprintOf(OneOfEach()[0]), 0xe3d17423180b5e8dU);
  EXPECT_EQ(FingerprintOf(OneOfEach()[1]), 0x89dc5b879a5056cfU);
  EXPECT_EQ(FingerprintOf(OneOfEach()[2]), 0x2e16efb052b0105eU);
  EXPECT_EQ(FingerprintOf(OneOfEach()[3]), 0x1f317af1246276acU);
  EXPECT_EQ(FingerprintOf(OneOfEach()[4]), 0xea9ffbf2acc5c5aeU);
  EXPECT_EQ(FingerprintOf(std::vector<uint8_t>(7)), std::nullopt);
}

TEST(DecodeTest, PlanarLidarBearingsFollowFromStartAndStep) {
  const auto readings = DecodeScan(OneOfEach()[0]);
  ASSERT_TRUE(readings.ok()) << readings.status();
  EXPECT_EQ(readings->ranges_m, (std::vector<float>{1, 2, 3}));
  EXPECT_EQ(readings->bearings_rad, (std::vector<float>{-1, -0.5, 0}));
  EXPECT_TRUE(readings->beam_utimes.empty());
}

TEST(DecodeTest, MichiganLidarKeepsBearingsAndBeamTimes) {
  const auto readings = DecodeScan(OneOfEach()[1]);
  ASSERT_TRUE(readings.ok()) << readings.status();
  EXPECT_EQ(readings->utime, Utime(5'000'000));
  EXPECT_EQ(readings->bearings_rad, (std::vector<float>{0, 3}));
  EXPECT_EQ(readings->beam_utimes[1], Utime(5'100'000));
}

TEST(DecodeTest, PosesOfBothFamilies) {
  const auto pose = DecodePose(Encode(PoseMessage({Utime(9), {{1, 2}, 2.5}})));
  ASSERT_TRUE(pose.ok()) << pose.status();
  EXPECT_EQ(pose->utime, Utime(9));
  EXPECT_EQ(pose->world_T_robot.position_m, Eigen::Vector2d(1, 2));
  EXPECT_NEAR(pose->world_T_robot.yaw_rad, 2.5, 1e-12);

  michigan::pose_xyt_t xyt{};
  xyt.utime = 4;
  xyt.x = 1;
  xyt.theta = -0.5F;
  EXPECT_EQ(DecodePose(Encode(xyt))->world_T_robot.yaw_rad, -0.5);
}

TEST(DecodeTest, StatusRoundTrips) {
  const auto status = Decode<status_t>(Encode(Status()));
  ASSERT_TRUE(status.ok()) << status.status();
  EXPECT_EQ(status->drop_reasons, Status().drop_reasons);
  EXPECT_EQ(status->problems, Status().problems);
  EXPECT_EQ(status->problem_counts, Status().problem_counts);
  EXPECT_EQ(status->last_problem, "none");
}

TEST(DecodeTest, AnotherTypeIsNamedByItsFingerprint) {
  const auto status = DecodeScan(OneOfEach()[2]).status();
  EXPECT_TRUE(absl::IsInvalidArgument(status));
  EXPECT_NE(std::string(status.message()).find("0x2e16efb052b0105e"), std::string::npos) << status;
}

TEST(DecodeTest, MessagesAreDescribedAsFarAsTheyAreKnown) {
  // As the Michigan stacks have them.
  const std::vector<uint8_t> grid = {0xd5, 0x44, 0x7e, 0x49, 0x4a, 0x66, 0xcc, 0x92, 0};
  EXPECT_NE(Describe(grid).find("occupancy_grid_t"), std::string::npos);
  const std::vector<uint8_t> path = {0xef, 0xad, 0xf5, 0x83, 0xaf, 0x37, 0x40, 0x79, 0};
  EXPECT_NE(Describe(path).find("path2D_t"), std::string::npos);
  EXPECT_NE(Describe(OneOfEach()[2]).find("bot_core.pose_t"), std::string::npos);
  EXPECT_NE(Describe(std::vector<uint8_t>(20)).find("0x0000000000000000"), std::string::npos);
  EXPECT_EQ(Describe(std::vector<uint8_t>(3)), "3 bytes that are no LCM message");
}

TEST(DecodeTest, SensorMountIsThePlanarPartOfATransform) {
  const auto mount = DecodeSensorMount(Encode(Turned(2, 2.5)));
  ASSERT_TRUE(mount.ok()) << mount.status();
  EXPECT_EQ(mount->robot_T_sensor.position_m, Eigen::Vector2d(0.1, -0.2));
  EXPECT_NEAR(mount->robot_T_sensor.yaw_rad, 2.5, 1e-12);
  EXPECT_FALSE(mount->is_upside_down);
}

TEST(DecodeTest, ASensorThatHangsUpsideDownIsTold) {
  const auto about_x = DecodeSensorMount(Encode(Turned(0, M_PI)));
  ASSERT_TRUE(about_x.ok()) << about_x.status();
  EXPECT_TRUE(about_x->is_upside_down);
  EXPECT_NEAR(about_x->robot_T_sensor.yaw_rad, 0, 1e-12);
  const auto about_y = DecodeSensorMount(Encode(Turned(1, M_PI)));
  EXPECT_TRUE(about_y->is_upside_down);
  EXPECT_NEAR(std::abs(about_y->robot_T_sensor.yaw_rad), M_PI, 1e-12);
}

TEST(DecodeTest, ATransformThatMakesNoPlanarSensorIsRefused) {
  EXPECT_TRUE(DecodeSensorMount(Encode(Turned(0, 9 * M_PI / 180))).ok());
  EXPECT_FALSE(DecodeSensorMount(Encode(Turned(0, 11 * M_PI / 180))).ok()) << "tilted";
  bot_core::rigid_transform_t transform = Turned(2, 0);
  transform.quat[0] = 1.009;
  EXPECT_TRUE(DecodeSensorMount(Encode(transform)).ok()) << "within tolerance";
  transform.quat[0] = 0;
  EXPECT_FALSE(DecodeSensorMount(Encode(transform)).ok()) << "no unit quaternion";
  transform = Turned(2, 0);
  transform.trans[1] = std::nan("");
  EXPECT_FALSE(DecodeSensorMount(Encode(transform)).ok()) << "NaN";
  transform.trans[1] = 1000;
  EXPECT_FALSE(DecodeSensorMount(Encode(transform)).ok()) << "far away";
  EXPECT_FALSE(DecodeSensorMount(OneOfEach()[2]).ok()) << "another type";
}

TEST(DecodeTest, EveryTruncationAndTrailingByteIsRefused) {
  for (const std::vector<uint8_t>& whole : OneOfEach()) {
    for (size_t size = 0; size < whole.size(); ++size) {
      const std::vector<uint8_t> part(whole.begin(), whole.begin() + size);
      EXPECT_FALSE(DecodeScan(part).ok() || DecodePose(part).ok() || DecodeSensorMount(part).ok() ||
                   Decode<status_t>(part).ok() || Decode<sweeps_request_t>(part).ok() ||
                   Decode<points_reply_t>(part).ok() || Decode<likelihoods_request_t>(part).ok());
    }
    std::vector<uint8_t> longer = whole;
    longer.push_back(0);
    EXPECT_FALSE(DecodeScan(longer).ok() || DecodePose(longer).ok() ||
                 DecodeSensorMount(longer).ok() || Decode<status_t>(longer).ok() ||
                 Decode<sweeps_request_t>(longer).ok() || Decode<points_reply_t>(longer).ok() ||
                 Decode<likelihoods_request_t>(longer).ok());
  }
}

TEST(DecodeTest, ClaimedCountsAllocateNothing) {
  // Each aligned group of four bytes in turn claims -1, 2^31 - 1 and 2e9.
  largest_allocation = 0;
  for (const std::vector<uint8_t>& whole : OneOfEach()) {
    for (size_t at = 8; at + 4 <= whole.size(); ++at) {
      for (const uint32_t claim : {0xffffffffU, 0x7fffffffU, 2'000'000'000U, 0U, 1U}) {
        std::vector<uint8_t> hostile = whole;
        for (size_t k = 0; k < 4; ++k)
          hostile[at + k] = static_cast<uint8_t>(claim >> (24 - 8 * k));
        DecodeAll(hostile);
      }
    }
  }
  EXPECT_LT(largest_allocation, 10'000u);
}

TEST(DecodeTest, AStringOfNoLengthIsRefused) {
  status_t status = Status();
  status.name = "";
  std::vector<uint8_t> bytes = Encode(status);
  // After fingerprint and utime: length 1 and a closing 0. Claim 0 and leave the 0 out.
  ASSERT_EQ(bytes[19], 1);
  bytes[19] = 0;
  bytes.erase(bytes.begin() + 20);
  EXPECT_FALSE(Decode<status_t>(bytes).ok());
}

TEST(DecodeTest, RandomBytesBehindARealFingerprintDoNoHarm) {
  std::mt19937_64 random(1);
  for (int n = 0; n < 20'000; ++n) {
    std::vector<uint8_t> bytes = OneOfEach()[n % 9];
    for (int flips = 0; flips < 5; ++flips) {
      bytes[8 + random() % (bytes.size() - 8)] = static_cast<uint8_t>(random());
    }
    DecodeAll(bytes);
  }
}

TEST(DecodeTest, ImplausibleValuesAreRefused) {
  bot_core::pose_t pose = PoseMessage({Utime(1), {}});
  pose.utime = -1;
  EXPECT_FALSE(DecodePose(Encode(pose)).ok()) << "negative time";
  pose.utime = std::numeric_limits<int64_t>::max();
  EXPECT_FALSE(DecodePose(Encode(pose)).ok()) << "far future";
  pose.utime = 1;
  pose.pos[1] = std::nan("");
  EXPECT_FALSE(DecodePose(Encode(pose)).ok()) << "NaN";
  pose.pos[1] = 0;
  pose.orientation[0] = 0;
  EXPECT_FALSE(DecodePose(Encode(pose)).ok()) << "no unit quaternion";
  pose.orientation[0] = std::nan("");
  EXPECT_FALSE(DecodePose(Encode(pose)).ok()) << "NaN quaternion";
  pose.orientation[0] = 1.005;
  EXPECT_TRUE(DecodePose(Encode(pose)).ok()) << "within tolerance";
  bot_core::pose_t turned = PoseMessage({Utime(1), {{0, 0}, 2}});
  for (double& q : turned.orientation) q *= 1.009;
  EXPECT_NEAR(DecodePose(Encode(turned))->world_T_robot.yaw_rad, 2, 1e-12) << "not biased by it";

  bot_core::planar_lidar_t planar = PlanarLidarMessage(Utime(1), {1}, 0, 0);
  planar.radstep = std::numeric_limits<float>::infinity();
  EXPECT_FALSE(DecodeScan(Encode(planar)).ok());
  michigan::lidar_t lidar = MichiganScan();
  lidar.times[1] = std::numeric_limits<int64_t>::min();
  EXPECT_TRUE(DecodeScan(Encode(lidar)).ok()) << "beam times matter only where they are used";
}

layer_updates_t Updates() {
  layer_updates_t updates{};
  updates.layer.name = "robot";
  updates.layer.origin = 1;
  updates.layer.session_number = 2;
  updates.layer.session_nonce = 3;
  updates.num_tiles = 2;
  updates.tiles.resize(2);
  for (tile_update_t& tile : updates.tiles) {
    tile = {};
    tile.num_bytes = 3;
    tile.content = {1, 2, 3};
  }
  return updates;
}

TEST(DecodeTest, UpdatesOfLayersAreWholeOrRefused) {
  const std::vector<uint8_t> bytes = Encode(Updates());
  const auto decoded = Decode<layer_updates_t>(bytes);
  ASSERT_TRUE(decoded.ok()) << decoded.status();
  EXPECT_EQ(decoded->tiles[1].content, (std::vector<uint8_t>{1, 2, 3}));
  for (size_t size = 0; size < bytes.size(); ++size) {
    EXPECT_FALSE(Decode<layer_updates_t>({bytes.data(), size}).ok()) << size;
  }
  std::vector<uint8_t> claims_more = bytes;
  claims_more[bytes.size() - 7] = 0x7f;  // of the last content
  EXPECT_FALSE(Decode<layer_updates_t>(claims_more).ok());
  EXPECT_FALSE(Decode<layer_pull_t>(bytes).ok());
}

TEST(DecodeTest, HeadersOfRequestsAndRepliesAreReadWithoutTheRest) {
  const std::vector<uint8_t> request = Encode(Sweeps());
  const auto header = RequestHeaderOf({request.data(), 40});
  ASSERT_TRUE(header.has_value());
  EXPECT_EQ(header->client, 1);
  EXPECT_EQ(header->id, 2);
  EXPECT_EQ(header->query, 3);
  EXPECT_EQ(header->daemon_nonce, -4);
  EXPECT_FALSE(RequestHeaderOf({request.data(), 39}).has_value());
  EXPECT_FALSE(ReplyIdOf(request).has_value());
  const std::vector<uint8_t> reply = Encode(PointsReply());
  EXPECT_EQ(ReplyIdOf(reply), 7);
  EXPECT_FALSE(ReplyIdOf({reply.data(), 15}).has_value());
  EXPECT_FALSE(RequestHeaderOf(reply).has_value());
  const auto sweeps = Decode<sweeps_request_t>(request);
  ASSERT_TRUE(sweeps.ok()) << sweeps.status();
  EXPECT_EQ(sweeps->sweeps[1].y_m, (std::vector<double>{2}));
  EXPECT_TRUE(absl::IsInvalidArgument(Decode<rays_request_t>(request).status()));
}

// Followers send the name on, and LCM ends strings at a 0.
TEST(DecodeTest, NamesOfLayersAreShortText) {
  layer_updates_t updates = Updates();
  updates.layer.name = "";
  EXPECT_FALSE(Decode<layer_updates_t>(Encode(updates)).ok());
  updates.layer.name = std::string(257, 'x');
  EXPECT_FALSE(Decode<layer_updates_t>(Encode(updates)).ok());
  updates.layer.name = "ab";
  std::vector<uint8_t> bytes = Encode(updates);
  ASSERT_TRUE(Decode<layer_updates_t>(bytes).ok());
  ASSERT_EQ(bytes[20], 'a');
  bytes[21] = 0;
  EXPECT_FALSE(Decode<layer_updates_t>(bytes).ok());
}

// What a follower takes, it saves: nothing may get in that the reader of a file refuses.
TEST(DecodeTest, NumbersOfLayersThatNoOwnerReachesAreRefused) {
  const auto digest_with = [](auto change) {
    layer_digest_t digest{};
    digest.layer = Updates().layer;
    digest.protocol_version = kProtocolVersion;
    digest.knot_interval_m = 0.05;
    digest.min_control_point = -2560;
    digest.max_control_point = 2560;
    digest.root_level = 1;
    change(digest);
    return Decode<layer_digest_t>(Encode(digest)).status();
  };
  static constexpr auto kMost = static_cast<int64_t>(kMaxRevision);
  EXPECT_TRUE(digest_with([](auto& d) { d.revision = kMost; }).ok());
  EXPECT_FALSE(digest_with([](auto& d) { d.revision = kMost + 1; }).ok());
  EXPECT_FALSE(digest_with([](auto& d) { d.revision = -1; }).ok());
  EXPECT_TRUE(digest_with([](auto& d) { d.layer.session_number = kMost; }).ok());
  EXPECT_FALSE(digest_with([](auto& d) { d.layer.session_number = kMost + 1; }).ok());
  EXPECT_FALSE(digest_with([](auto& d) { d.layer.session_number = -1; }).ok());
  EXPECT_FALSE(digest_with([](auto& d) { d.layer.level = 9; }).ok());
  EXPECT_FALSE(digest_with([](auto& d) { d.layer.statistic = 1; }).ok());
  EXPECT_FALSE(digest_with([](auto& d) { d.knot_interval_m = 1e-320; }).ok());
  EXPECT_FALSE(digest_with([](auto& d) { d.knot_interval_m = std::nan(""); }).ok());
  EXPECT_FALSE(digest_with([](auto& d) { d.max_control_point = 1 << 15; }).ok());
  EXPECT_FALSE(digest_with([](auto& d) { d.min_control_point = 0; }).ok());
  EXPECT_FALSE(digest_with([](auto& d) { d.num_tiles = -1; }).ok());
  EXPECT_FALSE(digest_with([](auto& d) { d.state = -1; }).ok());
  EXPECT_FALSE(digest_with([](auto& d) { d.root_level = 9; }).ok());
  EXPECT_FALSE(
      digest_with([](auto& d) { d.lag_s = std::numeric_limits<double>::infinity(); }).ok());
  EXPECT_FALSE(digest_with([](auto& d) { d.utime = -1; }).ok());

  layer_updates_t updates = Updates();
  updates.tiles[1].revision = kMost + 1;
  EXPECT_FALSE(Decode<layer_updates_t>(Encode(updates)).ok());
  layer_listing_t listing{};
  listing.layer = updates.layer;
  listing.num_nodes = 1;
  listing.nodes.resize(1);
  listing.nodes[0].level = 1;
  listing.nodes[0].x = 0;
  listing.nodes[0].y = 0;
  listing.nodes[0].num_children = 1;
  listing.nodes[0].children = {0};
  listing.nodes[0].hashes = {7};
  listing.nodes[0].revisions = {kMost};
  EXPECT_TRUE(Decode<layer_listing_t>(Encode(listing)).ok());
  listing.nodes[0].revisions = {kMost + 1};
  EXPECT_FALSE(Decode<layer_listing_t>(Encode(listing)).ok());
}

}  // namespace splinemap::decode_test
