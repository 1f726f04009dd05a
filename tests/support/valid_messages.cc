#include "tests/support/valid_messages.h"

#include <random>
#include <variant>

#include "lcmtypes/splinemap/command_request_t.hpp"
#include "lcmtypes/splinemap/layer_command_request_t.hpp"
#include "lcmtypes/splinemap/layer_digest_t.hpp"
#include "lcmtypes/splinemap/layer_pull_t.hpp"
#include "lcmtypes/splinemap/layer_scans_t.hpp"
#include "lcmtypes/splinemap/layer_settings_t.hpp"
#include "lcmtypes/splinemap/layer_updates_t.hpp"
#include "lcmtypes/splinemap/request_t.hpp"
#include "lcmtypes/splinemap/scan_pull_t.hpp"
#include "lcmtypes/splinemap/scan_record_t.hpp"
#include "lcmtypes/splinemap/settings_t.hpp"
#include "lcmtypes/splinemap/tile_update_t.hpp"
#include "lcmtypes/splinemap/trajectory_t.hpp"
#include "lib/archive/scan_record.h"
#include "lib/replication/byte_budget.h"
#include "lib/replication/pyramid_publisher.h"
#include "lib/replication/replication_message.h"
#include "lib/rpc/encoded.h"
#include "lib/tiles/tile_codec.h"
#include "lib/wire/encode.h"
#include "tests/support/queries.h"
#include "tests/support/random_map.h"

namespace splinemap {
namespace {

constexpr int64_t kSomebody = 99;

template <typename Message>
ValidMessage Make(const std::string& channel, const Message& message) {
  return {Message::getTypeName(), channel, Encode(message)};
}

template <typename Message>
ValidMessage Make(const Message& message) {
  return Make(ChannelOf(message, ""), message);
}

request_t Header(int64_t daemon_nonce) {
  request_t header{};
  header.client = kSomebody;
  header.id = 1;
  header.daemon_nonce = daemon_nonce;
  return header;
}

}  // namespace

std::vector<ValidMessage> MessagesOf(const LayerSnapshot& layer, const MapOptions& options) {
  const Clock::time_point now{};
  PyramidPublisher publisher(layer, options, {});
  layer_pull_t pull;
  pull.speaker = kSomebody;
  pull.layer = ToMessage(LayerRef{layer.id, layer.session, {}});
  pull.num_nodes = 3;
  pull.levels = {1, 1, 0};
  pull.xs = {0, -1, 0};
  pull.ys = {0, 0, 0};
  publisher.HandlePull(pull, now);
  scan_pull_t scan_pull{};
  scan_pull.speaker = kSomebody;
  scan_pull.layer = pull.layer;
  scan_pull.num_ranges = 1;
  scan_pull.first = {static_cast<int64_t>(layer.revision)};
  scan_pull.last = scan_pull.first;
  std::vector<ValidMessage> messages{Make(pull), Make(scan_pull)};
  ByteBudget budget(PublisherOptions().bytes_per_s);
  budget.Refill(now, publisher.HasChanges(), publisher.HasPulls());
  for (const ReplicationMessage& said : publisher.Tick(now, budget)) {
    std::visit([&](const auto& message) { messages.push_back(Make(message)); }, said);
    if (const auto* digest = std::get_if<layer_digest_t>(&said)) {
      layer_digest_t of_proxy = *digest;
      of_proxy.speaker = kSomebody;
      messages.push_back(Make(of_proxy));
    }
  }
  return messages;
}

ValidMessage FalseUpdates(const LayerSnapshot& layer, ControlPoint value) {
  layer_updates_t updates;
  updates.speaker = static_cast<int64_t>(layer.session.nonce);
  updates.layer = ToMessage(LayerRef{layer.id, layer.session, {}});
  Tile tile;
  tile.control_points.fill(value);
  for (const TileKey key : {TileKey{0, 0}, TileKey{5, 5}}) {
    const TileUpdate update = MakeTileUpdate(key, tile, layer.revision + 1);
    tile_update_t& message = updates.tiles.emplace_back();
    message.tx = key.tx;
    message.ty = key.ty;
    message.revision = static_cast<int64_t>(update.revision);
    message.base_checksum = 0;
    message.checksum = static_cast<int64_t>(update.checksum);
    message.num_bytes = static_cast<int32_t>(update.content.size());
    message.content.assign(update.content.begin(), update.content.end());
  }
  updates.num_tiles = static_cast<int32_t>(updates.tiles.size());
  return Make(updates);
}

ValidMessage FalseScan(const LayerSnapshot& layer) {
  std::mt19937_64 random(1);
  const PosedScan scan = RandomScan(random, 1);
  const std::string beams = PackBeams(scan, {});
  layer_scans_t message{};
  message.speaker = static_cast<int64_t>(layer.session.nonce);
  message.layer = ToMessage(LayerRef{layer.id, layer.session, {}});
  message.oldest = 1;
  message.num_scans = 1;
  scan_record_t& record = message.scans.emplace_back();
  record.revision = static_cast<int64_t>(layer.revision + 1);
  record.utime = scan.utime.count();
  record.robot_x = scan.world_T_robot.x;
  record.robot_y = scan.world_T_robot.y;
  record.robot_yaw = scan.world_T_robot.yaw;
  record.part = 0;
  record.num_parts = 1;
  record.content.assign(beams.begin(), beams.end());
  record.num_bytes = static_cast<int32_t>(beams.size());
  return Make(message);
}

ValidMessage SettingsMessage(const LayerId& id, uint64_t counter) {
  settings_t message;
  message.speaker = kSomebody;
  message.hash = 1;
  message.num_layers = 1;
  layer_settings_t& settings = message.layers.emplace_back();
  settings = {};
  settings.name = id.name;
  settings.origin = static_cast<int64_t>(id.origin);
  settings.counter = static_cast<int64_t>(counter);
  settings.writer = kSomebody;
  return Make(message);
}

ValidMessage TrajectoryMessage() {
  trajectory_t message{};
  message.utime = 3'000'000'000'000'000;
  message.robot = "nobody";
  message.num_parts = 1;
  message.num_poses = 2;
  message.pose_utime = {2'999'999'000'000'000, 3'000'000'000'000'000};
  message.x_m = {1, 2};
  message.y_m = {3, 4};
  message.yaw_rad = {0, 0.5};
  return Make("TRAJECTORY", message);
}

std::vector<ValidMessage> Queries(int64_t daemon_nonce) {
  std::mt19937_64 random(3);
  std::vector<ValidMessage> queries;
  const auto add = [&]<typename Query>(const Query& query) {
    queries.push_back({Rpc<Query>::Request::getTypeName(), Rpc<Query>::kChannel,
                       EncodeRequest(query, Split(query)[0], Header(daemon_nonce))});
  };
  add(RandomPoints(random, 2));
  add(RandomRays(random, 2));
  add(RandomSweeps(random, 2));
  add(RandomRaster(random, 2));
  add(RandomLikelihoods(random, 2));
  add(RandomDistances(random, 2));
  return queries;
}

std::vector<ValidMessage> LayerCommands(const LayerSnapshot& layer, int64_t daemon_nonce) {
  std::vector<ValidMessage> commands;
  for (const char* command : {"mute", "unmute", "low-weight", "normal-weight", "place", "remove"}) {
    layer_command_request_t request{};
    request.header = Header(daemon_nonce);
    request.command = command;
    request.name = layer.id.name;
    request.origin = static_cast<int64_t>(layer.id.origin);
    request.session_number = static_cast<int64_t>(layer.session.number);
    commands.push_back(Make(kCommandChannel, request));
  }
  return commands;
}

ValidMessage Command(const std::string& command, uint64_t session_number, int64_t daemon_nonce) {
  command_request_t request{};
  request.header = Header(daemon_nonce);
  request.command = command;
  request.session_number = static_cast<int64_t>(session_number);
  return Make(kCommandChannel, request);
}

}  // namespace splinemap
