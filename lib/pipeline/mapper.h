#pragma once

#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "absl/types/span.h"
#include "lib/config/config.h"
#include "lib/diagnosis/reading_statistics.h"
#include "lib/diagnosis/sensor_option_search.h"
#include "lib/mapping/fold.h"
#include "lib/pipeline/notice.h"
#include "lib/sensing/drop_counts.h"
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

  // Is told of each scan that is kept, and the revision that the layer will have with it, before it
  // is mapped.
  using OnScan = std::function<void(uint64_t revision, const PackedScan& scan)>;
  void SetOnScan(OnScan on_scan) { on_scan_ = std::move(on_scan); }

  // The scans that the layer is made of.
  const ScanArchive& archive() const { return archive_; }
  // Where the layer was replaced by another fold, or cleared.
  void ReplaceArchive(ScanArchive archive);
  // The layer with its archive.
  LayerSnapshot Snapshot();

  // The channels to feed.
  const std::vector<std::string>& channels() const { return channels_; }

  // One message of any channel; what is none of channels() is ignored. What cannot be used is
  // dropped and counted. When it was received counts where scans are to be stamped with that.
  void HandleMessage(const std::string& channel, absl::Span<const uint8_t> message,
                     Utime received = Utime(0));

  // The end of input: maps what still can be placed.
  void Flush();

  // Keeps that many bytes of scans at most from now on; the oldest go into the base.
  void LimitArchive(size_t max_bytes);
  // Why no scan is mapped any more; empty: they are.
  void Refuse(std::string why) { why_refused_ = std::move(why); }

  MapperCounts counts() const;
  size_t scans_queued() const { return queue_.size(); }
  Utime newest_scan_utime() const { return newest_scan_utime_; }

  // What happened since the last call: chosen presets, drops by kind and channel, problems.
  std::vector<Notice> DrainNotices() { return notices_.Take(); }

 private:
  struct ScanChannel {
    config::Scan config;
    std::optional<SensorOptions> options;   // known from the first message on
    std::optional<SensorMount> mount;       // newest of its extrinsics_channel
    std::unique_ptr<DriveCollector> drive;  // until the flags were tried on it
    std::string preset;                     // of options
    std::optional<MessageType> type;        // of message that options are for
    std::map<MessageType, std::string> detected_presets;
    std::string better_options;  // if there are any, in words
    ReadingStatistics readings;
    std::optional<Utime> newest_utime;      // of its scans, time offset included
    std::optional<Pose2> last_map_T_robot;  // of its last scan mapped
    int scans_before_flags = 0;
    int disagreeing_in_a_row = 0;  // scans whose hits lie in free space
    bool has_no_poses = false;     // many scans in a row had no pose
  };

  void HandleScan(int channel, absl::Span<const uint8_t> message, Utime received);
  void HandlePose(absl::Span<const uint8_t> message);
  void HandleExtrinsics(ScanChannel& channel, absl::Span<const uint8_t> message);
  bool ChooseOptions(ScanChannel& channel, MessageType type, const RangeReadings& readings);
  void MapReadyScans();
  void MapScan(PosedScan scan);
  void Keep(PackedScan scan);
  void KeepNoScans();
  bool HasMoved(const ScanChannel& channel, const Pose2& map_T_robot) const;
  void Drop(DropReason reason, const std::string& channel, const std::string& explanation);
  void Find(Problem problem, const std::string& channel, std::string text);
  void NoticeQueueDrops();
  void NoticePoseJump();
  void NoticeMissingPoses(int index);
  std::string WhyWithoutPoses(int index) const;
  void CheckAgainstMap(ScanChannel& channel, const PlacedScan& scan);
  void TryFlagsOnceFull(ScanChannel& channel);
  void TryOtherFlags(ScanChannel& channel);
  void CheckReadings(ScanChannel& channel, const RangeReadings& readings);

  std::vector<std::string> channels_;
  std::string pose_channel_;
  std::vector<ScanChannel> scan_channels_;
  double max_coordinate_m_;
  MapOptions map_options_;
  Layer& layer_;
  // The map as it was some scans ago, with which scans are compared.
  TileTree earlier_tiles_;
  bool is_continued_;  // earlier_tiles_ were there before the first scan
  int scans_since_earlier_ = 0;
  size_t max_tiles_;
  size_t max_archive_bytes_;
  std::string why_refused_;
  OnScan on_scan_;
  ScanArchive archive_;
  BeamModelOptions beam_model_;
  ScanFolder folder_;
  PlacedScan placed_;
  ScanQueue queue_;
  MapperCounts counts_;
  Utime newest_scan_utime_{0};
  ScanQueueCounts noticed_;  // counts of queue_ that were noticed
  std::optional<Utime> newest_pose_utime_;
  bool poses_are_coarse_ = false;
  NoticeList notices_;
};

}  // namespace splinemap
