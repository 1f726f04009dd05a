#include "lib/render/map_parts.h"

#include <algorithm>
#include <map>
#include <utility>

namespace splinemap {
namespace {

// Squares of 8 x 8 tiles that have any.
using Squares = std::map<TileKey, MapPart>;

void Add(const TileBox& other, TileBox& box) {
  box.Add(TileKey{other.tx0, other.ty0});
  box.Add(TileKey{other.tx1 - 1, other.ty1 - 1});
}

// Takes a square and all that are connected to it.
MapPart TakePart(Squares& squares) {
  MapPart part;
  std::vector<TileKey> next{squares.begin()->first};
  while (!next.empty()) {
    const TileKey key = next.back();
    next.pop_back();
    const auto square = squares.extract(key);
    if (square.empty()) continue;  // taken already
    Add(square.mapped().box, part.box);
    part.tiles += square.mapped().tiles;
    for (const int32_t dx : {-1, 0, 1}) {
      for (const int32_t dy : {-1, 0, 1}) next.push_back({key.tx + dx, key.ty + dy});
    }
  }
  return part;
}

}  // namespace

std::vector<MapPart> PartsOf(const MapView& map) {
  Squares squares;
  map.tiles.ForEach([&](TileKey key, const TileTree::Entry&) {
    MapPart& square = squares[{key.tx >> 3, key.ty >> 3}];
    square.box.Add(key);
    ++square.tiles;
  });
  std::vector<MapPart> parts;
  while (!squares.empty()) parts.push_back(TakePart(squares));
  std::stable_sort(parts.begin(), parts.end(),
                   [](const MapPart& a, const MapPart& b) { return a.tiles > b.tiles; });
  return parts;
}

TileBox BoxOf(const std::vector<MapPart>& parts) {
  TileBox box;
  for (const MapPart& part : parts) Add(part.box, box);
  return box;
}

}  // namespace splinemap
