#pragma once

#include <cstdint>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "absl/types/span.h"
#include "lib/base/work_beside.h"
#include "lib/config/config.h"
#include "lib/diagnosis/reading_statistics.h"
#include "lib/diagnosis/sensor_option_search.h"
#include "lib/pipeline/findings.h"
#include "lib/pipeline/layer_builder.h"
#include "lib/sensing/scan_queue.h"
#include "lib/wire/message_type.h"
#include "splinemap/layer.h"
#include "splinemap/map_view.h"
#include "splinemap/scan_archive.h"

namespace splinemap {

// Totals since construction.
struct MapperCounts {
  int64_t messages_received = 0;
  int64_t bytes_received = 0;
  int64_t scans_received = 0;  // of them, messages on scan channels
  int64_t poses_received = 0;
  int64_t scans_mapped = 0;
  int64_t beams_received = 0;  // readings of all scans that could be decoded
  int64_t beams_mapped = 0;
  DropCounts drops;
  ProblemCounts problems{};
};

// From LCM messages to commits: decode, bring scans and poses together, accumulate, commit. The
// same messages in the same order make the same layer, in the daemon and offline.
// Thread-compatible.
class Mapper {
 public:
  // Requires CheckConfig(config).ok(). `layer` outlives the mapper and goes on; it is the fold of
  // `archive`.
  Mapper(const config::Config& config, MapOptions map_options, Layer& layer,
         ScanArchive archive = {});
  Mapper(const Mapper&) = delete;
  Mapper& operator=(const Mapper&) = delete;

  // Is told of each scan that is kept, and the revision that the layer will have with it, before it
  // is mapped.
  using OnScan = LayerBuilder::OnScan;
  void SetOnScan(OnScan on_scan) { builder_.SetOnScan(std::move(on_scan)); }

  // The scans that the layer is made of.
  const ScanArchive& archive() const { return builder_.archive(); }
  // Where the layer was replaced by another fold, or cleared.
  void ReplaceArchive(ScanArchive archive) { builder_.ReplaceArchive(std::move(archive)); }
  // The layer with its archive.
  LayerSnapshot Snapshot() { return builder_.Snapshot(); }

  // Maps in a thread of its own, while the next messages are read. Once at most, before the first
  // message; between that and Flush(), nothing but HandleMessage() and channels() may be called.
  void MapBeside();

  // The channels to feed.
  const std::vector<std::string>& channels() const { return channels_; }

  // One message of any channel; what is none of channels() is ignored. What cannot be used is
  // dropped and counted. When it was received counts where scans are to be stamped with that.
  void HandleMessage(const std::string& channel, absl::Span<const uint8_t> message,
                     Utime received = Utime(0));

  // The end of input: maps what still can be placed.
  void Flush();

  // Keeps that many bytes of scans at most from now on; the oldest go into the base.
  void LimitArchive(size_t max_bytes) { builder_.LimitArchive(max_bytes); }
  // Why no scan is mapped any more; empty: they are.
  void Refuse(std::string why) { builder_.Refuse(std::move(why)); }

  MapperCounts counts() const;
  size_t scans_queued() const { return queue_.size(); }
  Utime newest_scan_utime() const { return builder_.newest_scan_utime(); }

  // What happened since the last call: chosen presets, drops by kind and channel, problems.
  std::vector<Notice> DrainNotices() { return findings_.notices.Take(); }

 private:
  struct ScanChannel {
    config::Scan config;
    std::optional<SensorOptions> options;   // known from the first message on
    std::optional<SensorMount> mount;       // newest of its extrinsics_channel
    std::unique_ptr<DriveCollector> drive;  // until the flags were tried on it
    std::string preset;                     // of options
    std::optional<MessageType> type;        // of message that options are for
    std::map<MessageType, std::string> detected_presets;
    ReadingStatistics readings;
    std::optional<Utime> newest_utime;  // of its scans, time offset included
    bool has_no_poses = false;          // many scans in a row had no pose
  };

  void HandleScan(int channel, absl::Span<const uint8_t> message, Utime received);
  void HandlePose(absl::Span<const uint8_t> message);
  void HandleExtrinsics(ScanChannel& channel, absl::Span<const uint8_t> message);
  bool ChooseOptions(ScanChannel& channel, MessageType type, const RangeReadings& readings);
  void MapReadyScans();
  // What was found, after all scans until now are mapped, so that it comes in one order.
  Findings& Settled();
  void NoticeQueueDrops();
  void NoticePoseJump();
  void NoticeMissingPoses(int index);
  std::string WhyWithoutPoses(int index) const;
  void TryFlagsOnceFull(int channel);
  void TryOtherFlags(int channel);
  void CheckReadings(ScanChannel& channel, const RangeReadings& readings);

  std::vector<std::string> channels_;
  std::string pose_channel_;
  std::vector<ScanChannel> scan_channels_;
  double max_coordinate_m_;
  ScanQueue queue_;
  MapperCounts counts_;
  ScanQueueCounts noticed_;  // counts of queue_ that were noticed
  std::optional<Utime> newest_pose_utime_;
  bool poses_are_coarse_ = false;

  Findings findings_;  // of builder_, too; see Settled()
  LayerBuilder builder_;
  LayerBuilder::Item item_;  // at hand, where nothing is mapped beside
  std::optional<WorkBeside<LayerBuilder::Item>> beside_;
};

}  // namespace splinemap
