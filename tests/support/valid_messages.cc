#include "tests/support/valid_messages.h"

#include <random>
#include <variant>

#include "lib/map/tile_update.h"
#include "lib/replication/channels.h"
#include "lib/replication/levels_publisher.h"
#include "lib/rpc/messages.h"
#include "lib/wire/encode.h"
#include "tests/support/queries.h"

namespace splinemap {
namespace {

constexpr int64_t kSomebody = 99;

template <typename Message>
ValidMessage Make(const std::string& channel, const Message& message) {
  return {Message::getTypeName(), channel, Encode(message)};
}

template <typename Message>
ValidMessage Make(const Message& message) {
  return Make(ChannelOf(message), message);
}

request_t Head(int64_t daemon_nonce) {
  request_t head{};
  head.client = kSomebody;
  head.id = 1;
  head.daemon_nonce = daemon_nonce;
  return head;
}

}  // namespace

std::vector<ValidMessage> MessagesOf(const LayerSnapshot& layer, const MapOptions& options) {
  const Clock::time_point now{};
  LevelsPublisher publisher(layer, options, {});
  layer_pull_t pull;
  pull.layer = ToMessage(LayerLife{layer.id, layer.epoch, {}});
  pull.num_nodes = 3;
  pull.levels = {1, 1, 0};
  pull.xs = {0, -1, 0};
  pull.ys = {0, 0, 0};
  publisher.TakePull(pull, now);
  std::vector<ValidMessage> messages{Make(pull)};
  for (const PublishedMessage& said : publisher.Tick(now)) {
    std::visit([&](const auto& message) { messages.push_back(Make(message)); }, said);
    if (const auto* digest = std::get_if<layer_digest_t>(&said)) {
      stand_in_digest_t stand_in;
      stand_in.daemon_nonce = kSomebody;
      stand_in.digest = *digest;
      messages.push_back(Make(stand_in));
    }
  }
  return messages;
}

ValidMessage FalseUpdates(const LayerSnapshot& layer, ControlPoint value) {
  layer_updates_t updates;
  updates.layer = ToMessage(LayerLife{layer.id, layer.epoch, {}});
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

ValidMessage ControlRecords(const LayerId& id, uint64_t counter) {
  control_records_t records;
  records.sender = kSomebody;
  records.hash = 1;
  records.num_records = 1;
  layer_control_t& record = records.records.emplace_back();
  record = {};
  record.name = id.name;
  record.origin = static_cast<int64_t>(id.origin);
  record.counter = static_cast<int64_t>(counter);
  record.writer = kSomebody;
  return Make(records);
}

std::vector<ValidMessage> Queries(int64_t daemon_nonce) {
  std::mt19937_64 random(3);
  std::vector<ValidMessage> queries;
  const auto add = [&]<typename Query>(const Query& query) {
    auto request = ToMessage(query, Cut(query)[0]);
    request.head = Head(daemon_nonce);
    queries.push_back(Make(Rpc<Query>::kChannel, request));
  };
  add(RandomPoints(random, 2));
  add(RandomRays(random, 2));
  add(RandomSweeps(random, 2));
  add(RandomRaster(random, 2));
  add(RandomLikelihoods(random, 2));
  add(RandomDistances(random, 2));
  return queries;
}

std::vector<ValidMessage> Decisions(const LayerSnapshot& layer, int64_t daemon_nonce) {
  std::vector<ValidMessage> decisions;
  for (const char* command : {"mute", "unmute", "yield", "insist", "shift", "remove"}) {
    layer_command_request_t request{};
    request.head = Head(daemon_nonce);
    request.command = command;
    request.name = layer.id.name;
    request.origin = static_cast<int64_t>(layer.id.origin);
    request.incarnation = static_cast<int64_t>(layer.epoch.incarnation);
    decisions.push_back(Make(kCommandChannel, request));
  }
  return decisions;
}

ValidMessage Command(const std::string& command, uint64_t incarnation, int64_t daemon_nonce) {
  command_request_t request{};
  request.head = Head(daemon_nonce);
  request.command = command;
  request.incarnation = static_cast<int64_t>(incarnation);
  return Make(kCommandChannel, request);
}

}  // namespace splinemap
