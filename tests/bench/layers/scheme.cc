#include "tests/bench/layers/scheme.h"

#include <algorithm>
#include <cmath>

#include "absl/container/flat_hash_set.h"

namespace splinemap {
namespace {

using Points = absl::Span<const ControlPoint>;

constexpr double kNoLimit = 1e9;

// Each layer within limits, log-odds, times a weight.
double Sum(Points points, double min, double max, double weight = 1) {
  double sum = 0;
  for (const ControlPoint point : points) {
    sum += weight * std::clamp<double>(point, min * kUnitsPerLogOdds, max * kUnitsPerLogOdds);
  }
  return sum;
}

Scheme::Read Limited(double min, double max, double weight = 1) {
  return [=](Points others, Points own) {
    return Sum(others, min, max, weight) + Sum(own, min, max, weight);
  };
}

Scheme::Read Limited(double limit) { return Limited(-limit, limit); }

Scheme::Read Plain() { return Limited(kNoLimit); }

// What one robot alone has seen stays as it is.
Scheme::Read LimitedWhereShared(double limit) {
  return [=](Points others, Points own) {
    const double applied = others.size() + own.size() > 1 ? limit : kNoLimit;
    return Sum(others, -applied, applied) + Sum(own, -applied, applied);
  };
}

double Mean(Points others, Points own) {
  return Plain()(others, own) / static_cast<double>(others.size() + own.size());
}

// What one robot is surest to be occupied and what one is surest to be free, however many others.
double Extremes(Points others, Points own) {
  double least = 0;
  double greatest = 0;
  for (const Points points : {others, own}) {
    for (const ControlPoint point : points) {
      least = std::min<double>(least, point);
      greatest = std::max<double>(greatest, point);
    }
  }
  return least + greatest;
}

Scheme::Read OthersLimited(double limit) {
  return [=](Points others, Points own) {
    return Sum(others, -limit, limit) + Sum(own, -kNoLimit, kNoLimit);
  };
}

// Others, however many, are outvoted by one that is sure.
Scheme::Read OthersWithin(double limit) {
  return [=](Points others, Points own) {
    const double units = limit * kUnitsPerLogOdds;
    return std::clamp(Plain()(others, {}), -units, units) + Plain()({}, own);
  };
}

// Others say something only where this robot has seen nothing.
double OwnFirst(Points others, Points own) {
  return own.empty() ? Plain()(others, {}) : Plain()({}, own);
}

ControlLimits Limits(double log_odds) {
  const auto limit = static_cast<ControlPoint>(std::lround(log_odds * kUnitsPerLogOdds));
  return {static_cast<ControlPoint>(-limit), limit};
}

std::vector<TileKey> AllKeys(const LayersOfRobots& layers) {
  absl::flat_hash_set<TileKey> keys;
  for (const TileTree& tiles : layers.tiles) {
    tiles.ForEach([&](TileKey key, const TileTree::Entry&) { keys.insert(key); });
  }
  return {keys.begin(), keys.end()};
}

}  // namespace

std::vector<std::vector<Scheme>> SchemesByClamp() {
  return {
      {
          {"sum", 10, 10, Plain()},
          // Limits on each layer when it is read.
          {"limit 5", 10, 10, Limited(5)},
          {"limit 3.5", 10, 10, Limited(3.5)},
          {"limit 2", 10, 10, Limited(2)},
          {"limit 5 where shared", 10, 10, LimitedWhereShared(5)},
          {"limit 2 where shared", 10, 10, LimitedWhereShared(2)},
          {"limit -5 +10", 10, 10, Limited(-5, 10)},
          {"limit -2 +10", 10, 10, Limited(-2, 10)},
          // Weights.
          {"weight 1/2", 10, 10, Limited(-kNoLimit, kNoLimit, 0.5)},
          {"mean", 10, 10, &Mean},
          {"extremes", 10, 10, &Extremes},
          // Wider merged maps.
          {"sum within 20", 10, 20, Plain()},
          {"sum within 100", 10, 100, Plain()},
          // With word of whose layers count less: those of other robots, as one robot's planner
          // reads them, or of owners that are gone.
          {"others limit 5", 10, 10, OthersLimited(5)},
          {"others limit 2", 10, 10, OthersLimited(2)},
          {"others limit 1", 10, 10, OthersLimited(1)},
          {"others within 8", 10, 10, OthersWithin(8)},
          {"others within 5", 10, 10, OthersWithin(5)},
          {"others within 3.5", 10, 10, OthersWithin(3.5)},
          {"others within 2", 10, 10, OthersWithin(2)},
          {"own first", 10, 10, &OwnFirst},
      },
      {
          {"clamp 5", 5, 5, Plain()},
          {"clamp 5 within 10", 5, 10, Plain()},
      },
      {
          {"clamp 100", 100, 100, Plain()},
          {"clamp 100 within 10", 100, 10, Plain()},
          {"clamp 100 limit 10", 100, 10, Limited(10)},
      },
  };
}

MapView Merge(const LayersOfRobots& layers, const Scheme& scheme,
              const std::vector<TileKey>& keys) {
  const ControlLimits limits = Limits(scheme.merged_clamp);
  TileTreeEditor merged;
  std::vector<std::shared_ptr<const Tile>> tiles;
  std::vector<ControlPoint> points;
  for (const TileKey key : keys.empty() ? AllKeys(layers) : keys) {
    tiles.clear();
    for (const TileTree& layer : layers.tiles) tiles.push_back(FindTile(layer, key));
    Tile& tile = merged.Edit(key, 0).Edit();
    for (int k = 0; k < Tile::kSize; ++k) {
      points.clear();
      size_t others = 0;
      for (size_t layer = 0; layer < tiles.size(); ++layer) {
        if (tiles[layer] == nullptr || tiles[layer]->control_points[k] == 0) continue;
        points.push_back(tiles[layer]->control_points[k]);
        if (layer < layers.first_own) others = points.size();
      }
      if (points.empty()) continue;
      const double sum =
          scheme.read(Points(points).subspan(0, others), Points(points).subspan(others));
      tile.control_points[k] = ClampTouched(static_cast<int32_t>(std::lround(sum)), limits);
    }
  }
  return {.options = {kKnotInterval_m, limits}, .tiles = merged.Freeze()};
}

}  // namespace splinemap
