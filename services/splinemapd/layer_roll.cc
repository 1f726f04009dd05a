#include "services/splinemapd/layer_roll.h"

#include <algorithm>

#include "lib/map/tile_update.h"

namespace splinemap {
namespace {

layer_status_t StatusOf(const LayerId& id, const LayerControl& control) {
  layer_status_t status{};
  status.name = id.name;
  status.origin = static_cast<int64_t>(id.origin);
  status.heard_s_ago = -1;
  status.muted = control.muted ? 1 : 0;
  status.yields = control.yields ? 1 : 0;
  status.shift_i = control.shift.i;
  status.shift_j = control.shift.j;
  status.removed_up_to = static_cast<int64_t>(control.removed_up_to);
  return status;
}

const char* StateOf(const FollowedLayer& layer) {
  if (layer.owner_is_silent) return "gone";
  return layer.in_sync ? "live" : "stale";
}

}  // namespace

std::vector<layer_status_t> LayerRoll::Call(const MapSnapshot& map,
                                            const std::vector<FollowedLayer>& followed) {
  std::vector<layer_status_t> statuses;
  std::map<LayerId, Tally> present;
  for (const LayerSnapshot& layer : map.layers) {
    layer_status_t& status = statuses.emplace_back(StatusOf(layer.id, map.controls.Of(layer.id)));
    const Tally& tally = TallyOf(layer);
    status.incarnation = static_cast<int64_t>(layer.epoch.incarnation);
    status.nonce = static_cast<int64_t>(layer.epoch.nonce);
    status.state = "own";
    status.heard_s_ago = 0;
    const auto heard = std::find_if(followed.begin(), followed.end(),
                                    [&](const auto& other) { return other.id == layer.id; });
    if (heard != followed.end()) {
      status.state = StateOf(*heard);
      status.heard_s_ago = heard->heard_s_ago;
    }
    status.revision = static_cast<int64_t>(layer.revision);
    status.num_tiles = static_cast<int64_t>(tally.hashes.num_tiles());
    status.hash = static_cast<int64_t>(tally.hashes.hash());
    const double knot_m = map.options.knot_interval_m;
    const double side_m = Tile::kSide * knot_m;
    status.area_m2 = static_cast<double>(status.num_tiles) * side_m * side_m;
    if (status.num_tiles > 0) {
      status.x0_m = tally.box.tx0 * side_m + status.shift_i * knot_m;
      status.y0_m = tally.box.ty0 * side_m + status.shift_j * knot_m;
      status.x1_m = tally.box.tx1 * side_m + status.shift_i * knot_m;
      status.y1_m = tally.box.ty1 * side_m + status.shift_j * knot_m;
    }
    present.insert(tallies_.extract(layer.id));
  }
  tallies_ = std::move(present);
  for (const auto& [id, control] : map.controls.records()) {
    if (control.removed_up_to == 0 || tallies_.contains(id)) continue;
    statuses.push_back(StatusOf(id, control));
    statuses.back().state = "removed";
  }
  return statuses;
}

const LayerRoll::Tally& LayerRoll::TallyOf(const LayerSnapshot& layer) {
  Tally& tally = tallies_[layer.id];
  if (tally.tree_line != layer.tiles.line()) tally = {};
  tally.tree_line = layer.tiles.line();
  layer.tiles.ForEachChanged(tally.tree_epoch, [&](TileKey key, const TileTree::Entry& entry) {
    tally.hashes.Set(key, TileChecksum(key, *entry.tile));
    tally.box.Add(key);
  });
  tally.tree_epoch = layer.tiles.epoch();
  return tally;
}

}  // namespace splinemap
