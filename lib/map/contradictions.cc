#include "lib/map/contradictions.h"

#include <xxhash.h>

#include "fmt/format.h"
#include "lib/map/control_point_reader.h"
#include "lib/map/summed_layers.h"

namespace splinemap {
namespace {

// An obstacle, and free space below minus that: 1 log-odds.
constexpr int kCertain = kUnitsPerLogOdds;
// Knots that the faces of one thing may lie apart in two layers.
constexpr int32_t kAround = 2;

// What the map says at its control points without one of its layers.
class OtherLayers {
 public:
  // `layer` as it is placed.
  OtherLayers(const TileTree& sum, const TileTree& layer) : sum_(sum), layer_(layer) {}

  int At(int32_t i, int32_t j) { return sum_.At(i, j) - layer_.At(i, j); }
  bool Knows(int32_t i, int32_t j) { return At(i, j) != 0; }
  bool IsFreeAround(int32_t i, int32_t j) {
    for (int32_t dj = -kAround; dj <= kAround; ++dj) {
      for (int32_t di = -kAround; di <= kAround; ++di) {
        if (At(i + di, j + dj) > -kCertain) return false;
      }
    }
    return true;
  }

 private:
  ControlPointReader sum_;
  ControlPointReader layer_;
};

}  // namespace

std::optional<double> Contradiction::share() const {
  if (compared < kMinCompared) return std::nullopt;
  return static_cast<double>(contradicted) / static_cast<double>(compared);
}

std::string ObstaclesText(const Contradiction& contradiction) {
  return fmt::format("{:.0f} % of {} obstacles", 100 * *contradiction.share(),
                     contradiction.compared);
}

namespace {

void VisitPointsOf(const LayerSet& set, const MapView& sum, uint64_t one_of,
                   ComparedPointVisitor visit) {
  for (const LayerSnapshot& layer : set.layers) {
    const LayerSettings& settings = set.settings.Of(layer.id);
    if (!settings.IsSummed()) continue;
    LayerSet alone{.options = set.options, .layers = {layer}};
    LayerSettings where;
    where.placement = settings.placement;
    where.counter = 1;
    alone.settings.Merge(layer.id, where);
    // All of it need not be in memory.
    constexpr size_t kTilesAtOnce = 256;
    const TileTree placed =
        SummedLayers({}, std::make_shared<TileMemory>(kTilesAtOnce)).Update(alone)->tiles;
    OtherLayers others(sum.tiles, placed);
    placed.ForEach([&](TileKey key, const TileTree::Entry& entry) {
      if (XXH3_64bits(&key, sizeof key) % one_of != 0) return;
      if (sum.tiles.Find(key) == entry.tile.get()) return;  // no other layer has any of it
      const std::shared_ptr<const Tile> tile = entry.tile->Get();
      for (int k = 0; k < Tile::kSize; ++k) {
        if (tile->control_points[k] < kCertain) continue;
        const int32_t i = Tile::kSide * key.tx + k % Tile::kSide;
        const int32_t j = Tile::kSide * key.ty + k / Tile::kSide;
        if (others.Knows(i, j)) visit(layer.id, i, j, others.IsFreeAround(i, j));
      }
    });
  }
}

}  // namespace

void VisitComparedPoints(const LayerSet& set, const MapView& sum, ComparedPointVisitor visit) {
  VisitPointsOf(set, sum, 1, visit);
}

std::map<LayerId, Contradiction> ContradictionsOf(const LayerSet& set, const MapView& sum) {
  // Of large maps a sample, since tiles may have to be read.
  constexpr size_t kMaxTiles = 20'000;
  size_t tiles = 0;
  for (const LayerSnapshot& layer : set.layers) tiles += layer.tiles.size();
  std::map<LayerId, Contradiction> contradictions;
  VisitPointsOf(set, sum, tiles / kMaxTiles + 1,
                [&](const LayerId& id, int32_t, int32_t, bool is_contradicted) {
                  Contradiction& of_layer = contradictions[id];
                  ++of_layer.compared;
                  of_layer.contradicted += is_contradicted ? 1 : 0;
                });
  return contradictions;
}

}  // namespace splinemap
