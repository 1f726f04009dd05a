#include "tests/bench/bandwidth/grid_messages.h"

#include <zstd.h>

#include <algorithm>
#include <cmath>
#include <utility>

namespace splinemap::bench {
namespace {

constexpr int8_t kUnknown = -1;
// Time, frame, resolution, size, pose of the origin, and LCM's own.
constexpr double kGridHeaderBytes = 100;

int8_t Occupancy(const SurfaceSample& sample) {
  if (!sample.known) return kUnknown;
  return static_cast<int8_t>(std::lround(100 / (1 + std::exp(-sample.log_odds))));
}

}  // namespace

GridMessages::GridMessages(const Eigen::AlignedBox2d& bounds_m, const MapOptions& options)
    : cell_m_(options.knot_interval_m),
      bounds_((bounds_m.min() / cell_m_).array().floor().cast<int>(),
              (bounds_m.max() / cell_m_).array().ceil().cast<int>()),
      cells_((bounds_.sizes().array() + 1).prod(), kUnknown) {}

void GridMessages::Update(const MapView& map) {
  map.tiles.ForEachChanged(std::exchange(version_, map.tiles.version()),
                           [&](TileKey key, const TileTree::Entry&) { UpdateTile(key, map); });
}

void GridMessages::UpdateTile(TileKey key, const MapView& map) {
  // A control point reaches two knot intervals.
  const Eigen::Vector2i corner(Tile::kSide * key.tx, Tile::kSide * key.ty);
  const Box box = Box(corner.array() - 2, corner.array() + Tile::kSide + 1).intersection(bounds_);
  std::vector<Eigen::Vector2d> points_m;
  for (int y = box.min().y(); y <= box.max().y(); ++y) {
    for (int x = box.min().x(); x <= box.max().x(); ++x) {
      points_m.emplace_back((x + 0.5) * cell_m_, (y + 0.5) * cell_m_);
    }
  }
  std::vector<SurfaceSample> samples(points_m.size());
  map.EvaluateMany(points_m, absl::MakeSpan(samples));
  const int width = bounds_.sizes().x() + 1;
  size_t n = 0;
  for (int y = box.min().y(); y <= box.max().y(); ++y) {
    for (int x = box.min().x(); x <= box.max().x(); ++x, ++n) {
      int8_t& cell = cells_[(y - bounds_.min().y()) * width + (x - bounds_.min().x())];
      if (std::exchange(cell, Occupancy(samples[n])) == cell) continue;
      changed_.extend(Eigen::Vector2i(x, y));
      known_.extend(Eigen::Vector2i(x, y));
    }
  }
}

MessageBytes GridMessages::DrainChanged() { return Message(std::exchange(changed_, Box())); }

MessageBytes GridMessages::Message(const Box& box) const {
  if (box.isEmpty()) return {};
  const int width = bounds_.sizes().x() + 1;
  std::vector<int8_t> message;
  for (int y = box.min().y(); y <= box.max().y(); ++y) {
    const auto row = cells_.begin() + (y - bounds_.min().y()) * width - bounds_.min().x();
    message.insert(message.end(), row + box.min().x(), row + box.max().x() + 1);
  }
  std::vector<char> compressed(ZSTD_compressBound(message.size()));
  const size_t bytes = ZSTD_compress(compressed.data(), compressed.size(), message.data(),
                                     message.size(), /*compressionLevel=*/3);
  return {kGridHeaderBytes + static_cast<double>(message.size()),
          kGridHeaderBytes + static_cast<double>(bytes)};
}

}  // namespace splinemap::bench
