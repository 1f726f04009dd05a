// A program of messages for a Mapper with several scan channels. What came in has to be accounted
// for, and the map stays within its size.

#include "lib/pipeline/mapper.h"

#include "tests/fuzz/fuzz.h"
#include "tests/fuzz/messages.h"
#include "tests/support/map_writer.h"

namespace splinemap::fuzz_mapper {

constexpr size_t kMaxMapMb = 1;
constexpr size_t kTilesPerMb = (1 << 20) / sizeof(Tile);
constexpr size_t kMaxTilesOfScan = 4096;  // beams of 20 m, knots of 2 m, inputs of some kB

const config::Config& Configuration() {
  static const config::Config config = [] {
    config::Config made;
    made.set_pose("POSE");
    for (const char* flag :
         {"AUTO,range_max_m=20,extrinsics_channel=MOUNT",
          "BOT:bot_core,range_max_m=20,no_return=free,x_m=1,yaw_deg=90,mask=0..45,mask=170..-170",
          "FIRST:michigan_2014,range_max_m=20,every_nth_beam=3,no_return_up_to_m=0.5",
          "LAST:mbot_2024,range_max_m=20,min_travel_m=0.5,min_turn_deg=10"}) {
      *made.add_scan() = *ParseScanFlag(flag);
    }
    made.mutable_method()->set_knot_interval_m(2);  // few samples, so many runs
    made.mutable_service()->set_max_map_mb(kMaxMapMb);
    Require(CheckConfig(made).ok(), "the configuration of the target is valid");
    return made;
  }();
  return config;
}

int64_t ScanDrops(const DropCounts& drops) {
  return drops.Total() - drops[DropReason::kWrongTypeOfPose] - drops[DropReason::kMalformedPose] -
         drops[DropReason::kPoseOutOfRange] - drops[DropReason::kDuplicatePose] -
         drops[DropReason::kMalformedExtrinsics];
}

void Run(FuzzInput input) {
  const std::string channels[] = {"POSE", "AUTO", "BOT", "FIRST", "LAST", "MOUNT", "OTHER"};
  MapWriter map(MapOptionsOf(Configuration().method()));
  Layer& layer = map.AddLayer({"robot", 1}, {1, 1});
  Mapper mapper(Configuration(), map.options(), layer);
  Utime clock = std::chrono::seconds(100);
  int64_t mounts = 0;
  while (!input.empty()) {
    if (input.Byte() == 0xff) mapper.Flush();
    ReadMessage(input, channels, clock,
                [&](const std::string& channel, absl::Span<const uint8_t> message) {
                  mapper.HandleMessage(channel, message);
                  mounts += channel == "MOUNT";
                });
    const MapperCounts counts = mapper.counts();
    Require(counts.scans_received + counts.poses_received + mounts == counts.messages_received,
            "messages are scans, poses or transforms");
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
  mapper.DrainNotices();
  Require(std::isfinite(map.View()->Evaluate(0.1, 0.1).log_odds), "the surface is finite");
}

const FuzzTarget target("mapper", &Run);

}  // namespace splinemap::fuzz_mapper
