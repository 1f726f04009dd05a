// A request, answered, or a reply, taken, whatever it says. The input is a byte that chooses the
// map or how much was asked, then the message after its fingerprint.

#include <vector>

#include "lcmtypes/splinemap/command_reply_t.hpp"
#include "lcmtypes/splinemap/command_request_t.hpp"
#include "lcmtypes/splinemap/layer_command_request_t.hpp"
#include "lcmtypes/splinemap/reply_t.hpp"
#include "lib/rpc/answer.h"
#include "lib/rpc/encoded.h"
#include "lib/wire/decode.h"
#include "lib/wire/encode.h"
#include "splinemap/local_map.h"
#include "tests/fuzz/fuzz.h"
#include "tests/fuzz/messages.h"
#include "tests/support/map_writer.h"

namespace splinemap::fuzz_rpc {

std::shared_ptr<const MapView> SmallMap(bool is_empty) {
  MapWriter map({});
  Layer& layer = map.AddLayer({"robot", 1}, {1, 1});
  if (!is_empty) {
    layer.BeginCommit();
    Tile& tile = layer.EditTile({0, 0});
    for (int k = 0; k < Tile::kSize; k += 3) {
      tile.control_points[k] = static_cast<ControlPoint>(1000 - 2 * k);
    }
    layer.EditTile({-1, 0}).control_points.fill(-300);
  }
  return map.View();
}

template <typename Query>
void RunRequest(FuzzInput input) {
  static const LocalMap maps[] = {LocalMap(SmallMap(true)), LocalMap(SmallMap(false))};
  const LocalMap& map = maps[input.Byte() % 2];
  const auto bytes = MessageOf(Rpc<Query>::Request::getHash(), input.Rest());
  RequestHeaderOf(bytes);
  Require(
      DecodeRequest<Query>(bytes).has_value() == Decode<typename Rpc<Query>::Request>(bytes).ok(),
      "the same requests are damaged however they are decoded");
  reply_t header{};
  header.name = "robot";
  const std::vector<uint8_t> reply = AnswerRequest(bytes, map, header);
  if (reply.empty()) return;
  Require(reply.size() <= kMaxRpcBytes, "replies fit a message");
  Require(Decode<typename Rpc<Query>::Reply>(reply).ok(), "replies can be decoded");
}

template <typename Query>
Query Asked(uint8_t size);
template <>
PointsQuery Asked(uint8_t size) {
  return {std::vector<Eigen::Vector2d>(size), size % 2 == 1};
}
template <>
RaysQuery Asked(uint8_t size) {
  return {std::vector<Ray>(size)};
}
template <>
SweepsQuery Asked(uint8_t size) {
  return {std::vector<Sweep>(size)};
}
template <>
RasterQuery Asked(uint8_t size) {
  return {{0, 0}, 1, size, 1};
}
template <>
LikelihoodsQuery Asked(uint8_t size) {
  return {{}, std::vector<Pose2>(size)};
}
template <>
DistancesQuery Asked(uint8_t size) {
  return {std::vector<Eigen::Vector2d>(size)};
}

template <typename Query>
void RunReply(FuzzInput input) {
  const uint8_t size = input.Byte();
  const auto bytes = MessageOf(Rpc<Query>::Reply::getHash(), input.Rest());
  ReplyIdOf(bytes);
  if (const auto header = ReplyHeaderOf(bytes)) StatusOf(*header).IgnoreError();
  typename Query::Answer answer;
  const Query query = Asked<Query>(size);
  HandleReply(bytes, query, {size / size_t{2}, size}, answer).status().IgnoreError();
}

template <typename Message>
void RunDecode(FuzzInput input) {
  input.Byte();
  Decode<Message>(MessageOf(Message::getHash(), input.Rest())).status().IgnoreError();
}

const FuzzTarget targets[] = {
    {"points_request", &RunRequest<PointsQuery>},
    {"points_reply", &RunReply<PointsQuery>},
    {"rays_request", &RunRequest<RaysQuery>},
    {"rays_reply", &RunReply<RaysQuery>},
    {"sweeps_request", &RunRequest<SweepsQuery>},
    {"sweeps_reply", &RunReply<SweepsQuery>},
    {"raster_request", &RunRequest<RasterQuery>},
    {"raster_reply", &RunReply<RasterQuery>},
    {"likelihoods_request", &RunRequest<LikelihoodsQuery>},
    {"likelihoods_reply", &RunReply<LikelihoodsQuery>},
    {"distances_request", &RunRequest<DistancesQuery>},
    {"distances_reply", &RunReply<DistancesQuery>},
    {"command_request", &RunDecode<command_request_t>},
    {"layer_command_request", &RunDecode<layer_command_request_t>},
    {"command_reply", &RunDecode<command_reply_t>},
};

}  // namespace splinemap::fuzz_rpc
