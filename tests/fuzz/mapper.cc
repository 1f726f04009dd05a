// A program of messages for a Mapper with several scan channels: valid ones, ones with raw fields,
// raw bytes. What came in has to be accounted for, and the map stays within its size.

#include "lib/pipeline/mapper.h"

#include <vector>

#include "lcmtypes/michigan/lidar_t.hpp"
#include "lcmtypes/michigan/pose_xyt_t.hpp"
#include "lib/wire/encode.h"
#include "tests/fuzz/fuzz.h"

namespace splinemap {
namespace {

constexpr size_t kMaxMapMb = 1;
constexpr size_t kTilesPerMb = (1 << 20) / sizeof(Tile);
constexpr size_t kMaxTilesOfScan = 4096;  // beams of 20 m, knots of 2 m, inputs of some kB

const config::Config& Configuration() {
  static const config::Config config = [] {
    config::Config made;
    made.set_pose("POSE");
    for (const char* flag :
         {"AUTO,range_max_m=20", "BOT:bot_core,range_max_m=20,no_return=free,x_m=1,yaw_deg=90",
          "FIRST:michigan_2014,range_max_m=20", "LAST:mbot_2024,range_max_m=20"}) {
      *made.add_scan() = *ParseScanFlag(flag);
    }
    made.mutable_method()->set_knot_interval_m(2);  // few samples, so many runs
    made.mutable_service()->set_max_map_mb(kMaxMapMb);
    Require(CheckConfig(made).ok(), "the configuration of the target is valid");
    return made;
  }();
  return config;
}

// A number near 0, an odd one, or any bytes.
template <typename Number>
Number TakeNumber(FuzzInput& input) {
  const uint8_t choice = input.Byte();
  if (choice == 0xff) return input.Take<Number>();
  return static_cast<Number>(static_cast<int8_t>(choice)) / Number{4};
}

// Message time goes on by steps of 10 ms, mostly.
Utime TakeUtime(FuzzInput& input, Utime& clock) {
  const auto step = static_cast<int8_t>(input.Byte());
  if (step == -128) return Utime(input.Take<int64_t>());
  clock += step * std::chrono::milliseconds(10);
  return clock;
}

std::vector<uint8_t> MichiganScan(FuzzInput& input, Utime utime) {
  michigan::lidar_t message{};
  message.utime = utime.count();
  message.num_ranges = input.Byte() % 64;
  for (int k = 0; k < message.num_ranges; ++k) {
    message.ranges.push_back(TakeNumber<float>(input));
    message.thetas.push_back(TakeNumber<float>(input));
    message.times.push_back(TakeUtime(input, utime).count());
    message.intensities.push_back(0);
  }
  return Encode(message);
}

std::vector<uint8_t> TakeMessage(FuzzInput& input, Utime& clock) {
  const uint8_t kind = input.Byte();
  const Utime utime = TakeUtime(input, clock);
  switch (kind % 6) {
    case 0: {
      const double x_m = TakeNumber<double>(input);
      const double y_m = TakeNumber<double>(input);
      return Encode(PoseMessage({utime, {{x_m, y_m}, TakeNumber<double>(input)}}));
    }
    case 1: {
      michigan::pose_xyt_t message{};
      message.utime = utime.count();
      message.x = TakeNumber<float>(input);
      message.y = TakeNumber<float>(input);
      message.theta = TakeNumber<float>(input);
      return Encode(message);
    }
    case 2: {
      std::vector<float> ranges_m(input.Byte() % 64);
      for (float& range_m : ranges_m) range_m = TakeNumber<float>(input);
      const auto first_rad = TakeNumber<double>(input);
      return Encode(PlanarLidarMessage(utime, ranges_m, first_rad, TakeNumber<double>(input)));
    }
    case 3:
      return MichiganScan(input, utime);
    case 4: {  // a valid message with a few bytes of something else
      std::vector<uint8_t> message = MichiganScan(input, utime);
      for (const uint8_t byte : input.Bytes(4)) message[input.Byte() % message.size()] = byte;
      return message;
    }
    default: {
      const absl::Span<const uint8_t> bytes = input.Bytes(input.Byte());
      return {bytes.begin(), bytes.end()};
    }
  }
}

int64_t ScanDrops(const DropCounts& drops) {
  return drops.Total() - drops[DropReason::kWrongTypeOfPose] - drops[DropReason::kMalformedPose] -
         drops[DropReason::kPoseOutOfRange] - drops[DropReason::kDuplicatePose] -
         drops[DropReason::kMalformedExtrinsics];
}

void Run(FuzzInput input) {
  Map map(MapOptionsOf(Configuration().method()));
  Layer& layer = map.AddLayer({"robot", 1}, {1, 1});
  Mapper mapper(Configuration(), map.options(), layer);
  std::vector<std::string> channels = mapper.channels();
  channels.push_back("OTHER");
  Utime clock = std::chrono::seconds(100);
  while (!input.empty()) {
    const uint8_t choice = input.Byte();
    if (choice == 0xff) mapper.Flush();
    mapper.HandleMessage(channels[choice % channels.size()], TakeMessage(input, clock));
    const MapperCounts counts = mapper.counts();
    Require(counts.scans_received + counts.poses_received == counts.messages_received,
            "messages are scans or poses");
    Require(counts.scans_received == counts.scans_mapped + ScanDrops(counts.drops) +
                                         static_cast<int64_t>(mapper.scans_queued()),
            "scans are mapped, dropped or queued");
    Require(layer.tiles().size() < kMaxMapMb * kTilesPerMb + kMaxTilesOfScan,
            "the map stays within max_map_mb");
  }
  mapper.Flush();
  Require(mapper.scans_queued() == 0, "a flush leaves nothing in the queue");
  Require(static_cast<int64_t>(layer.revision()) == mapper.counts().scans_mapped,
          "a scan is a commit");
  mapper.TakeNotices();
  Require(std::isfinite(map.Snapshot()->Evaluate(0.1, 0.1).log_odds), "the surface is finite");
}

}  // namespace
}  // namespace splinemap

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  splinemap::Run({data, size});
  return 0;
}
