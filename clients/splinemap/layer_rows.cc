#include "clients/splinemap/layer_rows.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <nlohmann/json.hpp>

#include "clients/splinemap/layer_name.h"
#include "clients/splinemap/typed_placement.h"
#include "fmt/format.h"
#include "fmt/ranges.h"
#include "lcmtypes/splinemap/layer_status_t.hpp"
#include "lib/base/plain_text.h"
#include "lib/layers/layer_extent.h"
#include "lib/map/contradictions.h"
#include "lib/map/placed_tile.h"
#include "lib/map/summed_layers.h"
#include "lib/replication/settings_gossip.h"
#include "lib/tiles/tile_codec.h"

namespace splinemap {
namespace {

constexpr std::array kHeader{"layer", "state",   "heard_s",      "file_s", "session", "commits",
                             "tiles", "area_m2", "contradicted", "box_m",  "hash",    "settings"};
using TableRow = std::array<std::string, kHeader.size()>;

TableRow CellsOf(const LayerRow& layer) {
  TableRow row;
  row.fill("-");
  row.front() = NameOf(layer.id);
  row.back() = TextOf(layer.settings, layer.placement, layer.content.has_value());
  if (layer.is_approximate) row.back() += ", approximate";
  if (!layer.state.empty()) row[1] = PlainText(layer.state);
  if (layer.heard_s_ago >= 0) row[2] = fmt::format("{:.1f}", layer.heard_s_ago);
  if (layer.file_age_s) row[3] = fmt::format("{:.0f}", *layer.file_age_s);
  if (!layer.content) return row;
  const LayerRow::Content& content = *layer.content;
  row[4] = fmt::to_string(content.session.number);
  row[5] = fmt::to_string(content.revision);
  row[6] = fmt::to_string(content.tiles);
  row[7] = fmt::format("{:.1f}", content.area_m2);
  if (content.contradicted) row[8] = fmt::format("{:.0f} %", 100 * *content.contradicted);
  if (const auto& box = content.box) {
    row[9] = fmt::format("{:.3f},{:.3f},{:.3f},{:.3f}", box->x0_m, box->y0_m, box->x1_m, box->y1_m);
  }
  row[10] = fmt::format("{:016x}", content.hash);
  return row;
}

}  // namespace

LayerRow RowOf(const layer_status_t& layer) {
  LayerRow row{{layer.settings.name, static_cast<uint64_t>(layer.settings.origin)},
               std::nullopt,
               FromMessage(layer.settings),
               FromMessage(layer.settings).placement *
                   FixedPose2::Nearest({{layer.frame_x_m, layer.frame_y_m}, layer.frame_yaw_rad}),
               layer.state,
               layer.heard_s_ago,
               layer.is_approximate != 0};
  if (layer.state == "removed") return row;
  row.content = LayerRow::Content{
      {static_cast<uint64_t>(layer.session_number), static_cast<uint64_t>(layer.session_nonce)},
      static_cast<uint64_t>(layer.revision),
      static_cast<size_t>(layer.num_tiles),
      layer.area_m2,
      std::nullopt,
      static_cast<uint64_t>(layer.hash),
      std::nullopt};
  if (layer.area_m2 > 0) {
    row.content->box = Region{layer.x0_m, layer.y0_m, layer.x1_m, layer.y1_m};
  }
  if (layer.contradicted >= 0) row.content->contradicted = layer.contradicted;
  return row;
}

LayerRow RowOf(const LayerSnapshot& layer, const LayerSettings& settings, double knot_interval_m) {
  LayerExtent extent;
  extent.SetAll(layer.tiles);
  LayerRow::Content content{layer.session,
                            layer.revision,
                            layer.tiles.size(),
                            extent.area_m2(knot_interval_m),
                            extent.Box(settings.placement, knot_interval_m),
                            0,
                            std::nullopt};
  layer.tiles.ForEach([&](TileKey key, const TileTree::Entry& entry) {
    content.hash += entry.tile->Checksum(key);
  });
  return {layer.id,
          content,
          settings,
          PlacementOf(layer, settings),
          "",
          -1,
          IsApproximate(settings.placement, knot_interval_m)};
}

std::vector<LayerRow> RowsOf(const LayerSet& map) {
  std::vector<LayerRow> rows;
  const auto contradictions = ContradictionsOf(map, *ViewOf(map));
  for (const LayerSnapshot& layer : map.layers) {
    rows.push_back(RowOf(layer, map.settings.Of(layer.id), map.options.knot_interval_m));
    const auto found = contradictions.find(layer.id);
    if (found != contradictions.end()) rows.back().content->contradicted = found->second.share();
  }
  const size_t num_layers = rows.size();
  for (const auto& [id, settings] : map.settings.records()) {
    const bool is_there = std::any_of(rows.begin(), rows.begin() + num_layers,
                                      [&, &id = id](const LayerRow& row) { return row.id == id; });
    if (!is_there) rows.push_back({id, std::nullopt, settings, settings.placement, "", -1, false});
  }
  return rows;
}

FixedPose2 PlacementOf(const LayerSnapshot& layer, const LayerSettings& settings) {
  if (layer.archive == nullptr) return settings.placement;
  return settings.placement * layer.archive->map_T_world;
}

std::string TextOf(const LayerSettings& settings, const FixedPose2& placement, bool is_there) {
  // A removal of earlier sessions does not matter to a layer that is there.
  if (settings.removed_up_to > 0 && !is_there) return "removed";
  std::vector<std::string> texts;
  if (settings.muted) texts.push_back("muted");
  if (settings.low_weight) texts.push_back("low weight");
  if (!placement.IsIdentity()) {
    const TypedPlacement typed(placement);
    texts.push_back(fmt::format("placed at {}, {} m, {} deg", typed.x_m, typed.y_m, typed.yaw_deg));
  }
  return fmt::format("{}", fmt::join(texts, ", "));
}

std::string TableOf(const std::vector<LayerRow>& layers) {
  std::vector<TableRow> rows(1);
  std::copy(kHeader.begin(), kHeader.end(), rows.front().begin());
  for (const LayerRow& layer : layers) rows.push_back(CellsOf(layer));
  std::array<size_t, kHeader.size()> widths{};
  for (const TableRow& row : rows) {
    for (size_t k = 0; k < row.size(); ++k) widths[k] = std::max(widths[k], row[k].size());
  }
  const bool has_state = std::any_of(layers.begin(), layers.end(),
                                     [](const LayerRow& layer) { return !layer.state.empty(); });
  const bool is_live = std::any_of(layers.begin(), layers.end(),
                                   [](const LayerRow& layer) { return layer.heard_s_ago >= 0; });
  const bool has_files = std::any_of(layers.begin(), layers.end(), [](const LayerRow& layer) {
    return layer.file_age_s.has_value();
  });
  std::string table;
  for (const TableRow& row : rows) {
    std::string text;
    for (size_t k = 0; k < row.size(); ++k) {
      if ((!has_state && k == 1) || (!is_live && k == 2) || (!has_files && k == 3)) continue;
      const bool is_number = k > 1 && k < 9;
      text += is_number ? fmt::format("{:>{}}  ", row[k], widths[k])
                        : fmt::format("{:<{}}  ", row[k], widths[k]);
    }
    text.erase(text.find_last_not_of(' ') + 1);
    table += text + '\n';
  }
  return table;
}

nlohmann::json ToJson(const LayerRow& row) {
  const LayerSettings& settings = row.settings;
  const TypedPlacement placement(row.placement);
  nlohmann::json json = {
      {"name", row.id.name},
      {"origin", fmt::format("{:016x}", row.id.origin)},
      {"muted", settings.muted},
      {"low_weight", settings.low_weight},
      {"placement",
       {{"x_m", placement.x_m}, {"y_m", placement.y_m}, {"yaw_deg", placement.yaw_deg}}},
      {"is_approximate", row.is_approximate},
      {"removed_up_to", settings.removed_up_to},
      {"in_sum", row.content.has_value() && settings.IsSummed()},
  };
  if (!row.state.empty()) {
    json["state"] = row.state;
    json["heard_s_ago"] = row.heard_s_ago;
  }
  if (row.file_age_s) json["file_age_s"] = *row.file_age_s;
  if (!row.content) return json;
  const LayerRow::Content& content = *row.content;
  json["session_number"] = content.session.number;
  json["session_nonce"] = fmt::format("{:016x}", content.session.nonce);
  json["commits"] = content.revision;
  json["tiles"] = content.tiles;
  json["area_m2"] = content.area_m2;
  json["contradicted"] = nullptr;
  if (content.contradicted) json["contradicted"] = *content.contradicted;
  if (const auto& box = content.box) json["box_m"] = {box->x0_m, box->y0_m, box->x1_m, box->y1_m};
  json["hash"] = fmt::format("{:016x}", content.hash);
  return json;
}

}  // namespace splinemap
