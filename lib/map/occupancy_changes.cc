#include "lib/map/occupancy_changes.h"

#include <algorithm>
#include <set>

#include "lib/map/control_point_reader.h"

namespace splinemap {
namespace {

constexpr int kSure = kUnitsPerLogOdds;
// Knots that the faces of one thing may lie apart, and its parts.
constexpr int32_t kNear = 2;
constexpr size_t kFewest = 3;

// What is an obstacle in `with`, and free with all around it in `without`.
std::set<Knot> ObstaclesWithout(const TileTree& with, const TileTree& without) {
  ControlPointReader reader(without);
  const auto is_free_around = [&](Knot knot) {
    for (int32_t j = knot.j - kNear; j <= knot.j + kNear; ++j) {
      for (int32_t i = knot.i - kNear; i <= knot.i + kNear; ++i) {
        if (reader.At(i, j) > -kSure) return false;
      }
    }
    return true;
  };
  std::set<Knot> knots;
  with.ForEach([&](TileKey key, const TileTree::Entry& entry) {
    if (without.Find(key) == entry.tile.get()) return;
    const std::shared_ptr<const Tile> tile = entry.tile->Get();
    for (int k = 0; k < Tile::kSize; ++k) {
      const Knot knot{Tile::kSide * key.tx + k % Tile::kSide,
                      Tile::kSide * key.ty + k / Tile::kSide};
      if (tile->control_points[k] >= kSure && is_free_around(knot)) knots.insert(knot);
    }
  });
  return knots;
}

// Takes those that are near to `first`, and near to them, and so on.
std::vector<Knot> TakeCluster(std::set<Knot>& knots) {
  std::vector<Knot> cluster{*knots.begin()};
  knots.erase(knots.begin());
  for (size_t k = 0; k < cluster.size(); ++k) {
    const Knot around = cluster[k];
    for (int32_t i = around.i - kNear; i <= around.i + kNear; ++i) {
      for (int32_t j = around.j - kNear; j <= around.j + kNear; ++j) {
        if (knots.erase({i, j}) > 0) cluster.push_back({i, j});
      }
    }
  }
  return cluster;
}

Region RegionAround(const std::vector<Knot>& knots, double knot_m) {
  const auto by_i = [](Knot a, Knot b) { return a.i < b.i; };
  const auto by_j = [](Knot a, Knot b) { return a.j < b.j; };
  const auto [left, right] = std::minmax_element(knots.begin(), knots.end(), by_i);
  const auto [bottom, top] = std::minmax_element(knots.begin(), knots.end(), by_j);
  return {(left->i - 0.5) * knot_m, (bottom->j - 0.5) * knot_m, (right->i + 0.5) * knot_m,
          (top->j + 0.5) * knot_m};
}

}  // namespace

std::vector<OccupancyChange> OccupancyChanges(const MapView& before, const MapView& now) {
  std::vector<OccupancyChange> changes;
  for (const bool is_occupied : {true, false}) {
    std::set<Knot> knots = is_occupied ? ObstaclesWithout(now.tiles, before.tiles)
                                       : ObstaclesWithout(before.tiles, now.tiles);
    while (!knots.empty()) {
      std::vector<Knot> cluster = TakeCluster(knots);
      if (cluster.size() < kFewest) continue;
      const Region region = RegionAround(cluster, now.options.knot_interval_m);
      changes.push_back({is_occupied, region, std::move(cluster)});
    }
  }
  std::stable_sort(changes.begin(), changes.end(),
                   [](const auto& a, const auto& b) { return a.knots.size() > b.knots.size(); });
  return changes;
}

}  // namespace splinemap
