#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "absl/functional/function_ref.h"
#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/types/span.h"
#include "splinemap/beam_model_options.h"
#include "splinemap/posed_scan.h"
#include "splinemap/tile_tree.h"

namespace splinemap {

// Where and when a scan was made.
struct ScanPose {
  Utime utime{0};
  FixedPose2 world_T_robot;
};

// Scans that were mapped one after the other in the same way, packed. Immutable.
struct ScanBlock {
  // A block is full with so many scans, or with so many beams before its last scan, so that it fits
  // a row of a map file.
  static constexpr int kMaxScans = 256;
  static constexpr int kMaxBeams = 24'000;

  BeamModelOptions model;
  std::string poses;                         // a PosesRecord
  std::shared_ptr<const std::string> beams;  // a BeamsRecord
  int num_scans = 0;

  size_t bytes() const { return poses.size() + beams->size(); }
};

using PosedScans = std::vector<std::shared_ptr<const PosedScan>>;

// A scan whose beams are packed (lib/archive/scan_record.h).
struct PackedScan {
  ScanPose pose;
  size_t num_beams = 0;
  std::shared_ptr<const std::string> beams;
};

PackedScan Pack(const PosedScan& scan, const BeamModelOptions& model);
// Requires one scan at least, and not more than fit, all of them of this model.
std::shared_ptr<const ScanBlock> MakeBlock(const BeamModelOptions& model,
                                           absl::Span<const PackedScan> scans);
// Of bytes that a file says. DataLoss where they cannot be.
absl::StatusOr<std::shared_ptr<const ScanBlock>> BlockOf(std::string poses, std::string beams);
PosedScans UnpackScans(const ScanBlock& block);
std::vector<ScanPose> UnpackPoses(const ScanBlock& block);
// The same scans elsewhere. Requires a pose for each scan.
std::shared_ptr<const ScanBlock> WithPoses(const ScanBlock& block,
                                           absl::Span<const ScanPose> poses);

// The scans that a layer is made of, in the order in which they were mapped: layer = fold(archive),
// byte for byte (lib/mapping/fold.h). A value, cheap to copy. Thread-compatible.
class ScanArchive {
 public:
  // What scans that are not kept any more have left.
  struct Base {
    TileTree tiles;
    FixedPose2 map_T_world;  // that they were mapped with
    int64_t scans = 0;       // 0 where nobody counted them
    Utime newest{0};         // the greatest time of them; 0 where nobody knows
    bool IsEmpty() const { return tiles.size() == 0; }
  };

  // From the frame of the poses to that of the layer.
  FixedPose2 map_T_world;
  Base base;

  bool IsEmpty() const { return num_scans_ == 0 && base.IsEmpty(); }
  int64_t num_scans() const { return num_scans_; }
  // Of them and those that were taken out.
  int64_t scans_added() const { return num_scans_ + taken_out_; }
  // Packed; of the poses of the last scans, an estimate.
  size_t bytes() const { return bytes_; }

  // After all others.
  void Add(PackedScan scan, const BeamModelOptions& model);
  void Add(const std::shared_ptr<const PosedScan>& scan, const BeamModelOptions& model);
  void Add(std::shared_ptr<const ScanBlock> block);

  // The oldest block, which is taken out; null where there is none.
  std::shared_ptr<const ScanBlock> TakeOldest();

  // All scans, packed. Blocks stay the same objects until their scans or poses change; but for the
  // last, which is made anew while scans are added to it.
  std::vector<std::shared_ptr<const ScanBlock>> Blocks() const;

  // In the order of mapping.
  void ForEach(absl::FunctionRef<void(const PosedScan&, const BeamModelOptions&)> visit) const;
  void ForEachPose(absl::FunctionRef<void(const ScanPose&)> visit) const;
  // Those that were added after the first `added`.
  void ForEachAfter(int64_t added,
                    absl::FunctionRef<void(const PosedScan&, const BeamModelOptions&)> visit) const;

  // The scans for which `is_kept` is true, in their order; the base stays.
  ScanArchive Filtered(absl::FunctionRef<bool(const ScanPose&)> is_kept) const;
  // The scans with other poses, of which `move` says which.
  ScanArchive Moved(absl::FunctionRef<FixedPose2(const ScanPose&)> move) const;

 private:
  using BlockList = std::vector<std::shared_ptr<const ScanBlock>>;

  void CloseBlock();

  std::shared_ptr<const BlockList> blocks_ = std::make_shared<BlockList>();
  // Scans that do not fill a block yet, and what is to be known of them.
  std::vector<PackedScan> tail_;
  BeamModelOptions tail_model_;
  size_t tail_beams_ = 0;
  int64_t num_scans_ = 0;
  int64_t taken_out_ = 0;
  size_t bytes_ = 0;
};

}  // namespace splinemap
