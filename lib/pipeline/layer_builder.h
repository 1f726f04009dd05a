#pragma once

#include <cstddef>
#include <cstdint>
#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "lib/config/config.h"
#include "lib/mapping/fold.h"
#include "lib/pipeline/findings.h"
#include "splinemap/layer.h"
#include "splinemap/map_view.h"
#include "splinemap/posed_scan.h"
#include "splinemap/scan_archive.h"

namespace splinemap {

// Maps scans that have poses: keeps each, compares it with the map, and commits it to the layer.
// Thread-compatible; Prepare() and Map() may be called by two threads.
class LayerBuilder {
 public:
  // As Mapper. `findings` outlives it.
  LayerBuilder(const config::Config& config, MapOptions map_options, Layer& layer,
               ScanArchive archive, Findings& findings);

  // A scan, and what its channel says of robots that stand still.
  struct Item {
    PosedScan scan;
    double min_travel_m = 0;
    double min_turn_rad = 0;
    bool is_filtered() const;
    // What of the following is there:
    bool is_placed = false;
    bool has_lines = false;
    PlacedScan placed;
    absl::Status can_be;
    PackedScan packed;
    ScanLines lines;
  };
  // Does for an item what needs neither the layer nor the scans before.
  void Prepare(Item& item);
  // Of an item that may be prepared, and others after it, too.
  void Map(Item& item);

  // Where other flags of a scan channel were tried: better ones in words, if there are any.
  void SetFlagsTried(int channel, std::string better_options);

  // See Mapper.
  using OnScan = std::function<void(uint64_t revision, const PackedScan& scan)>;
  void SetOnScan(OnScan on_scan) { on_scan_ = std::move(on_scan); }
  const ScanArchive& archive() const { return archive_; }
  void ReplaceArchive(ScanArchive archive);
  LayerSnapshot Snapshot();
  void LimitArchive(size_t max_bytes);
  void Refuse(std::string why) { why_refused_ = std::move(why); }

  int64_t scans_mapped() const { return scans_mapped_; }
  int64_t beams_mapped() const { return beams_mapped_; }
  Utime newest_scan_utime() const { return newest_scan_utime_; }

 private:
  struct Channel {
    std::string name;
    std::optional<Pose2> last_map_T_robot;  // of its last scan mapped
    bool are_flags_tried = false;
    std::string better_options;
    int scans_before_flags = 0;
    int disagreeing_in_a_row = 0;  // scans whose hits lie in free space
  };

  void MakeLines(ScanFolder& folder, Item& item) const;
  void Keep(PackedScan scan);
  void KeepNoScans();
  static bool HasMoved(const Channel& channel, const Item& item);
  void CheckAgainstMap(Channel& channel, const PlacedScan& scan);

  std::string pose_channel_;
  std::vector<Channel> channels_;
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
  ScanFolder preparing_;
  ScanFolder folder_;
  Findings& findings_;
  int64_t scans_mapped_ = 0;
  int64_t beams_mapped_ = 0;
  Utime newest_scan_utime_{0};
};

}  // namespace splinemap
