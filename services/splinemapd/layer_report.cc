#include "services/splinemapd/layer_report.h"

#include <algorithm>

#include "lib/map/placed_tile.h"
#include "lib/replication/settings_gossip.h"
#include "lib/tiles/tile_codec.h"

namespace splinemap {
namespace {

layer_status_t StatusOf(const LayerId& id, const LayerSettings& setting) {
  layer_status_t status{};
  status.settings = ToMessage(id, setting, /*has_layer=*/true);
  status.heard_s_ago = -1;
  status.contradicted = -1;
  return status;
}

const char* StateOf(const FollowedLayer& layer) {
  if (layer.owner_is_silent) return "gone";
  return layer.caught_up ? "live" : "stale";
}

}  // namespace

std::vector<layer_status_t> LayerReport::Outline(const LayerSet& set,
                                                 const std::vector<FollowedLayer>& followed) {
  std::vector<layer_status_t> statuses;
  for (const LayerSnapshot& layer : set.layers) {
    const LayerSettings& setting = set.settings.Of(layer.id);
    layer_status_t& status = statuses.emplace_back(StatusOf(layer.id, setting));
    status.session_number = static_cast<int64_t>(layer.session.number);
    status.session_nonce = static_cast<int64_t>(layer.session.nonce);
    status.state = "own";
    const auto heard = std::find_if(followed.begin(), followed.end(),
                                    [&](const auto& other) { return other.id == layer.id; });
    if (heard != followed.end()) status.state = StateOf(*heard);
    status.num_tiles = layer.tiles.size() > 0 ? 1 : 0;
  }
  for (const auto& [id, setting] : set.settings.records()) {
    if (setting.removed_up_to == 0 || set.Find(id) != nullptr) continue;
    statuses.push_back(StatusOf(id, setting));
    statuses.back().state = "removed";
  }
  return statuses;
}

std::vector<layer_status_t> LayerReport::Make(
    const LayerSet& set, const std::vector<FollowedLayer>& followed,
    const std::map<LayerId, Contradiction>& contradictions) {
  std::vector<layer_status_t> statuses = Outline(set, followed);
  std::map<LayerId, Summary> present;
  for (size_t k = 0; k < set.layers.size(); ++k) {
    const LayerSnapshot& layer = set.layers[k];
    layer_status_t& status = statuses[k];
    Summary& summary = SummaryOf(layer);
    status.heard_s_ago = 0;
    const auto heard = std::find_if(followed.begin(), followed.end(),
                                    [&](const auto& other) { return other.id == layer.id; });
    if (heard != followed.end()) status.heard_s_ago = heard->heard_s_ago;
    status.revision = static_cast<int64_t>(layer.revision);
    status.num_tiles = static_cast<int64_t>(summary.hashes.num_tiles());
    status.hash = static_cast<int64_t>(summary.hashes.hash());
    const Pose2 frame = layer.archive == nullptr ? Pose2() : layer.archive->map_T_world.ToPose();
    status.frame_x_m = frame.position_m.x();
    status.frame_y_m = frame.position_m.y();
    status.frame_yaw_rad = frame.yaw_rad;
    const double knot_m = set.options.knot_interval_m;
    const FixedPose2& placement = set.settings.Of(layer.id).placement;
    status.is_approximate = IsApproximate(placement, knot_m) ? 1 : 0;
    status.area_m2 = summary.extent.area_m2(knot_m);
    if (const auto& box = BoxOf(summary, placement, knot_m)) {
      status.x0_m = box->x0_m;
      status.y0_m = box->y0_m;
      status.x1_m = box->x1_m;
      status.y1_m = box->y1_m;
    }
    if (const auto found = contradictions.find(layer.id);
        found != contradictions.end() && status.num_tiles > 0) {
      status.contradicted = found->second.share().value_or(-1);
    }
    present.insert(summaries_.extract(layer.id));
  }
  summaries_ = std::move(present);
  return statuses;
}

const std::optional<Region>& LayerReport::BoxOf(Summary& summary, const FixedPose2& placement,
                                                double knot_interval_m) {
  if (!summary.box || summary.box->first != placement) {
    summary.box.emplace(placement, summary.extent.Box(placement, knot_interval_m));
  }
  return summary.box->second;
}

LayerReport::Summary& LayerReport::SummaryOf(const LayerSnapshot& layer) {
  Summary& summary = summaries_[layer.id];
  if (summary.lineage != layer.tiles.lineage()) summary = {};
  summary.lineage = layer.tiles.lineage();
  layer.tiles.ForEachChanged(summary.version, [&](TileKey key, const TileTree::Entry& entry) {
    summary.hashes.Set(key, entry.tile->Checksum(key));
    summary.extent.Set(key, entry.tile->Touched());
    summary.box.reset();
  });
  summary.version = layer.tiles.version();
  return summary;
}

}  // namespace splinemap
