#include "lib/matching/map_sketch.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "lib/base/status.h"

namespace splinemap {
namespace {

// Log-odds.
constexpr double kFree = -2;
// So many knot intervals before a face it is free.
constexpr double kBefore = 1.5;

double SlopeOf(const SurfaceSample& sample) { return sample.gradient_per_m.norm(); }

std::vector<SurfaceSample> SamplesAt(const MapView& map,
                                     const std::vector<Eigen::Vector2d>& points_m) {
  std::vector<SurfaceSample> samples(points_m.size());
  map.EvaluateMany(points_m, absl::MakeSpan(samples));
  return samples;
}

}  // namespace

absl::StatusOr<MapSketch> MapSketch::Of(const MapView& map, const MatchScale& scale) {
  MapSketch sketch(map.options.knot_interval_m);
  SPLINEMAP_RETURN_IF_ERROR(sketch.Index(map));
  sketch.FindWalls(map, sketch.ReadVertices(map));
  if (sketch.walls_.empty()) return FailedPrecondition("it has no walls");
  sketch.SpreadWalls(scale);
  return sketch;
}

absl::Status MapSketch::Index(const MapView& map) {
  // Of its box, and those that there are: 256 x 256 of them do not fit a search any more.
  constexpr int64_t kMostInBox = 1 << 22;
  constexpr size_t kMostTiles = 1 << 16;
  TileBox box;
  map.tiles.ForEach([&](TileKey key, const TileTree::Entry&) { box.Add(key); });
  const int64_t width = box.tx1 - box.tx0;
  const int64_t height = box.ty1 - box.ty0;
  if (map.tiles.size() > kMostTiles) {
    return FailedPrecondition(
        "it has {} tiles, and {} can be aligned; keep a part of it with splinemap crop",
        map.tiles.size(), kMostTiles);
  }
  if (width * height > kMostInBox) {
    const double side_m = Tile::kSide * knot_m_;
    return FailedPrecondition(
        "it is {:.0f} x {:.0f} m large, and its tiles are far apart; keep a part of it with "
        "splinemap crop",
        side_m * static_cast<double>(width), side_m * static_cast<double>(height));
  }
  first_i_ = Tile::kSide * box.tx0;
  first_j_ = Tile::kSide * box.ty0;
  width_ = static_cast<int32_t>(Tile::kSide * width);
  height_ = static_cast<int32_t>(Tile::kSide * height);
  directory_.assign(width * height, -1);
  map.tiles.ForEach([&](TileKey key, const TileTree::Entry&) { keys_.push_back(key); });
  // In rows, so that trees of another history give the same.
  std::sort(keys_.begin(), keys_.end(),
            [](TileKey a, TileKey b) { return std::pair(a.ty, a.tx) < std::pair(b.ty, b.tx); });
  for (size_t k = 0; k < keys_.size(); ++k) {
    directory_[(keys_[k].ty - box.ty0) * width + keys_[k].tx - box.tx0] = static_cast<int32_t>(k);
  }
  blocks_.resize(keys_.size());
  return absl::OkStatus();
}

// The log-odds at the vertices of all blocks.
std::vector<float> MapSketch::ReadVertices(const MapView& map) {
  std::vector<float> values;
  std::vector<Eigen::Vector2d> points_m(Tile::kSize);
  for (size_t block = 0; block < keys_.size(); ++block) {
    for (int k = 0; k < Tile::kSize; ++k) points_m[k] = PointOf(keys_[block], k);
    const std::vector<SurfaceSample> samples = SamplesAt(map, points_m);
    for (int k = 0; k < Tile::kSize; ++k) {
      Vertex& vertex = blocks_[block][k];
      vertex.is_known = samples[k].known;
      vertex.is_free = samples[k].known && samples[k].log_odds < kFree;
      values.push_back(static_cast<float>(samples[k].log_odds));
    }
  }
  return values;
}

void MapSketch::FindWalls(const MapView& map, const std::vector<float>& values) {
  // Where the level crosses the lines of the grid.
  std::vector<Eigen::Vector2d> points_m;
  std::vector<int> axes;
  const auto add_crossing = [&](size_t block, int k, int axis) {
    const int x = Tile::kSide * keys_[block].tx + k % Tile::kSide - first_i_ + (axis == 0 ? 1 : 0);
    const int y = Tile::kSide * keys_[block].ty + k / Tile::kSide - first_j_ + (axis == 1 ? 1 : 0);
    if (x == width_ || y == height_) return;
    const int other = BlockOf(x, y);
    if (other < 0 || !blocks_[other][IndexInTile(x, y)].is_known) return;
    const double from = values[Tile::kSize * block + k];
    const double to = values[size_t{Tile::kSize} * other + IndexInTile(x, y)];
    if ((from < 0) == (to < 0)) return;
    points_m.push_back(PointOf(keys_[block], k));
    points_m.back()[axis] += knot_m_ * from / (from - to);
    axes.push_back(axis);
  };
  for (size_t block = 0; block < keys_.size(); ++block) {
    for (int k = 0; k < Tile::kSize; ++k) {
      if (!blocks_[block][k].is_known) continue;
      add_crossing(block, k, 0);
      add_crossing(block, k, 1);
    }
  }
  // A face of length L and normal n crosses L |n_axis| / knot lines along an axis: with these
  // lengths its crossings add up to L (n_x^2 + n_y^2).
  std::vector<SurfaceSample> samples = SamplesAt(map, points_m);
  std::vector<double> lengths_m(points_m.size());
  for (size_t k = 0; k < points_m.size(); ++k) {
    const double slope = SlopeOf(samples[k]);
    if (slope * knot_m_ < kLeastFaceSlope) continue;
    lengths_m[k] = knot_m_ * std::abs(samples[k].gradient_per_m[axes[k]]) / slope;
    const double step_m = std::clamp(-samples[k].log_odds / slope, -0.5 * knot_m_, 0.5 * knot_m_);
    points_m[k] += step_m / slope * samples[k].gradient_per_m;
  }
  samples = SamplesAt(map, points_m);
  std::vector<Eigen::Vector2d> before_m = points_m;
  for (size_t k = 0; k < points_m.size(); ++k) {
    before_m[k] -= kBefore * knot_m_ * samples[k].gradient_per_m.stableNormalized();
  }
  const std::vector<SurfaceSample> before = SamplesAt(map, before_m);
  for (size_t k = 0; k < points_m.size(); ++k) {
    const double slope = SlopeOf(samples[k]);
    if (lengths_m[k] == 0 || slope * knot_m_ < kLeastFaceSlope) continue;
    if (!before[k].known || before[k].log_odds > kFree) continue;
    walls_.push_back({points_m[k], samples[k].gradient_per_m / slope, lengths_m[k]});
    wall_m_ += lengths_m[k];
  }
}

void MapSketch::SpreadWalls(const MatchScale& scale) {
  const double reach = scale.Reach() / knot_m_;
  std::vector<float> squares(size_t{Tile::kSize} * blocks_.size(),
                             std::numeric_limits<float>::infinity());
  for (size_t k = 0; k < walls_.size(); ++k) {
    const double x = walls_[k].point_m.x() / knot_m_ - first_i_;
    const double y = walls_[k].point_m.y() / knot_m_ - first_j_;
    const int x0 = std::max(static_cast<int>(std::ceil(x - reach)), 0);
    const int x1 = std::min(static_cast<int>(std::floor(x + reach)), width_ - 1);
    const int y0 = std::max(static_cast<int>(std::ceil(y - reach)), 0);
    const int y1 = std::min(static_cast<int>(std::floor(y + reach)), height_ - 1);
    for (int v = y0; v <= y1; ++v) {
      for (int u = x0; u <= x1; ++u) {
        const int block = BlockOf(u, v);
        if (block < 0) continue;
        const auto square = static_cast<float>((u - x) * (u - x) + (v - y) * (v - y));
        float& least = squares[size_t{Tile::kSize} * block + IndexInTile(u, v)];
        if (square > reach * reach || square >= least) continue;
        least = square;
        blocks_[block][IndexInTile(u, v)].wall = static_cast<int32_t>(k);
      }
    }
  }
  const double clearance = scale.Clearance() / knot_m_;
  for (size_t block = 0; block < blocks_.size(); ++block) {
    for (int k = 0; k < Tile::kSize; ++k) {
      Vertex& vertex = blocks_[block][k];
      vertex.is_open = vertex.is_free && squares[Tile::kSize * block + k] > clearance * clearance;
    }
  }
}

}  // namespace splinemap
