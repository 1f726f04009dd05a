#include "splinemap/scan_archive.h"

#include <algorithm>
#include <utility>

#include "lib/archive/scan_record.h"

namespace splinemap {
namespace {

// Of the pose of a scan in a block, on recorded drives.
constexpr size_t kBytesPerPose = 15;

size_t BytesOf(const PackedScan& scan) { return kBytesPerPose + scan.beams->size(); }

PosedScan Unpack(const PackedScan& packed) {
  const std::string& beams = *packed.beams;
  PosedScan scan =
      UnpackBeams({reinterpret_cast<const uint8_t*>(beams.data()), beams.size()})->scan;
  scan.utime = packed.pose.utime;
  scan.world_T_robot = packed.pose.world_T_robot;
  return scan;
}

}  // namespace

void ScanArchive::Add(const std::shared_ptr<const PosedScan>& scan, const BeamModelOptions& model) {
  Add(Pack(*scan, model), model);
}

void ScanArchive::Add(PackedScan scan, const BeamModelOptions& model) {
  if (!tail_.empty() && tail_model_ != model) CloseBlock();
  tail_model_ = model;
  tail_beams_ += scan.num_beams;
  bytes_ += BytesOf(scan);
  ++num_scans_;
  tail_.push_back(std::move(scan));
  if (tail_.size() >= ScanBlock::kMaxScans || tail_beams_ >= ScanBlock::kMaxBeams) CloseBlock();
}

void ScanArchive::Add(std::shared_ptr<const ScanBlock> block) {
  CloseBlock();
  auto blocks = std::make_shared<BlockList>(*blocks_);
  num_scans_ += block->num_scans;
  bytes_ += block->bytes();
  blocks->push_back(std::move(block));
  blocks_ = std::move(blocks);
}

void ScanArchive::CloseBlock() {
  if (tail_.empty()) return;
  const std::shared_ptr<const ScanBlock> block = MakeBlock(tail_model_, tail_);
  num_scans_ -= block->num_scans;
  for (const PackedScan& scan : tail_) bytes_ -= BytesOf(scan);
  tail_.clear();
  tail_beams_ = 0;
  Add(block);
}

std::shared_ptr<const ScanBlock> ScanArchive::TakeOldest() {
  CloseBlock();
  if (blocks_->empty()) return nullptr;
  const std::shared_ptr<const ScanBlock> oldest = blocks_->front();
  blocks_ = std::make_shared<BlockList>(blocks_->begin() + 1, blocks_->end());
  num_scans_ -= oldest->num_scans;
  taken_out_ += oldest->num_scans;
  bytes_ -= oldest->bytes();
  return oldest;
}

std::vector<std::shared_ptr<const ScanBlock>> ScanArchive::Blocks() const {
  BlockList blocks = *blocks_;
  if (!tail_.empty()) blocks.push_back(MakeBlock(tail_model_, tail_));
  return blocks;
}

void ScanArchive::ForEach(
    absl::FunctionRef<void(const PosedScan&, const BeamModelOptions&)> visit) const {
  ForEachAfter(taken_out_, visit);
}

void ScanArchive::ForEachAfter(
    int64_t added, absl::FunctionRef<void(const PosedScan&, const BeamModelOptions&)> visit) const {
  int64_t skipped = std::max<int64_t>(added - taken_out_, 0);
  for (const auto& block : *blocks_) {
    if (skipped >= block->num_scans) {
      skipped -= block->num_scans;
      continue;
    }
    for (const auto& scan : UnpackScans(*block)) {
      if (--skipped < 0) visit(*scan, block->model);
    }
    skipped = std::max<int64_t>(skipped, 0);
  }
  for (const PackedScan& scan : tail_) {
    if (--skipped < 0) visit(Unpack(scan), tail_model_);
  }
}

void ScanArchive::ForEachPose(absl::FunctionRef<void(const ScanPose&)> visit) const {
  for (const auto& block : *blocks_) {
    for (const ScanPose& pose : UnpackPoses(*block)) visit(pose);
  }
  for (const PackedScan& scan : tail_) visit(scan.pose);
}

ScanArchive ScanArchive::Filtered(absl::FunctionRef<bool(const ScanPose&)> is_kept) const {
  ScanArchive kept;
  kept.map_T_world = map_T_world;
  kept.base = base;
  for (const auto& block : *blocks_) {
    std::vector<bool> keep;
    for (const ScanPose& pose : UnpackPoses(*block)) keep.push_back(is_kept(pose));
    const auto count = std::count(keep.begin(), keep.end(), true);
    if (count == 0) continue;
    if (count == block->num_scans) {
      kept.Add(block);
      continue;
    }
    const PosedScans scans = UnpackScans(*block);
    for (size_t k = 0; k < scans.size(); ++k) {
      if (keep[k]) kept.Add(scans[k], block->model);
    }
  }
  for (const PackedScan& scan : tail_) {
    if (is_kept(scan.pose)) kept.Add(scan, tail_model_);
  }
  return kept;
}

ScanArchive ScanArchive::Moved(absl::FunctionRef<FixedPose2(const ScanPose&)> move) const {
  ScanArchive moved;
  moved.map_T_world = map_T_world;
  moved.base = base;
  for (const auto& block : *blocks_) {
    std::vector<ScanPose> poses = UnpackPoses(*block);
    bool is_moved = false;
    for (ScanPose& pose : poses) {
      const FixedPose2 to = move(pose);
      is_moved = is_moved || to != pose.world_T_robot;
      pose.world_T_robot = to;
    }
    moved.Add(is_moved ? WithPoses(*block, poses) : block);
  }
  for (PackedScan scan : tail_) {
    scan.pose.world_T_robot = move(scan.pose);
    moved.Add(std::move(scan), tail_model_);
  }
  return moved;
}

}  // namespace splinemap
