#include "clients/splinemap/layer_rows.h"

#include <algorithm>
#include <array>
#include <nlohmann/json.hpp>

#include "clients/splinemap/layer_name.h"
#include "fmt/format.h"
#include "fmt/ranges.h"
#include "lcmtypes/splinemap/layer_status_t.hpp"
#include "lib/base/plain_text.h"
#include "lib/replication/settings_gossip.h"
#include "lib/tiles/tile_codec.h"

namespace splinemap {
namespace {

// Control points, the last ones included.
struct KnotBox {
  int64_t i0 = INT64_MAX;
  int64_t j0 = INT64_MAX;
  int64_t i1 = INT64_MIN;
  int64_t j1 = INT64_MIN;

  void Add(int64_t i, int64_t j) {
    i0 = std::min(i0, i);
    j0 = std::min(j0, j);
    i1 = std::max(i1, i);
    j1 = std::max(j1, j);
  }
};

// Of the squares about these control points.
Region RegionOf(const KnotBox& box, KnotShift shift, double knot_interval_m) {
  const auto metres = [&](int64_t knot, int32_t by, double half) {
    return (static_cast<double>(knot + by) + half) * knot_interval_m;
  };
  return {metres(box.i0, shift.i, -0.5), metres(box.j0, shift.j, -0.5),
          metres(box.i1, shift.i, 0.5), metres(box.j1, shift.j, 0.5)};
}

constexpr std::array kHeader{"layer", "state",   "heard_s", "session", "commits",
                             "tiles", "area_m2", "box_m",   "hash",    "settings"};
using TableRow = std::array<std::string, kHeader.size()>;

TableRow CellsOf(const LayerRow& layer) {
  TableRow row;
  row.fill("-");
  row.front() = NameOf(layer.id);
  row.back() =
      TextOf(layer.settings, layer.content ? std::optional(layer.content->session) : std::nullopt);
  if (!layer.state.empty()) row[1] = PlainText(layer.state);
  if (layer.heard_s_ago >= 0) row[2] = fmt::format("{:.1f}", layer.heard_s_ago);
  if (!layer.content) return row;
  const LayerRow::Content& content = *layer.content;
  row[3] = fmt::to_string(content.session.number);
  row[4] = fmt::to_string(content.revision);
  row[5] = fmt::to_string(content.tiles);
  row[6] = fmt::format("{:.1f}", content.area_m2);
  if (const auto& box = content.box) {
    row[7] = fmt::format("{:.3f},{:.3f},{:.3f},{:.3f}", box->x0_m, box->y0_m, box->x1_m, box->y1_m);
  }
  row[8] = fmt::format("{:016x}", content.hash);
  return row;
}

}  // namespace

LayerRow RowOf(const layer_status_t& layer) {
  LayerRow row{{layer.settings.name, static_cast<uint64_t>(layer.settings.origin)},
               std::nullopt,
               FromMessage(layer.settings),
               layer.state,
               layer.heard_s_ago};
  if (layer.state == "removed") return row;
  row.content = LayerRow::Content{
      {static_cast<uint64_t>(layer.session_number), static_cast<uint64_t>(layer.session_nonce)},
      static_cast<uint64_t>(layer.revision),
      static_cast<size_t>(layer.num_tiles),
      layer.area_m2,
      std::nullopt,
      static_cast<uint64_t>(layer.hash)};
  if (layer.num_tiles > 0) {
    row.content->box = Region{layer.x0_m, layer.y0_m, layer.x1_m, layer.y1_m};
  }
  return row;
}

LayerRow RowOf(const LayerSnapshot& layer, const LayerSettings& settings, double knot_interval_m) {
  LayerRow::Content content{layer.session, layer.revision, layer.tiles.size(), 0, std::nullopt, 0};
  int64_t known = 0;
  KnotBox box;
  layer.tiles.ForEach([&](TileKey key, const TileTree::Entry& entry) {
    content.hash += TileChecksum(key, *entry.tile);
    for (int k = 0; k < Tile::kSize; ++k) {
      if (entry.tile->control_points[k] == 0) continue;
      ++known;
      box.Add(Tile::kSide * key.tx + k % Tile::kSide, Tile::kSide * key.ty + k / Tile::kSide);
    }
  });
  content.area_m2 = static_cast<double>(known) * knot_interval_m * knot_interval_m;
  if (known > 0) content.box = RegionOf(box, settings.shift, knot_interval_m);
  return {layer.id, content, settings, "", -1};
}

std::vector<LayerRow> RowsOf(const LayerSet& map) {
  std::vector<LayerRow> rows;
  for (const LayerSnapshot& layer : map.layers) {
    rows.push_back(RowOf(layer, map.settings.Of(layer.id), map.options.knot_interval_m));
  }
  const size_t num_layers = rows.size();
  for (const auto& [id, settings] : map.settings.records()) {
    const bool is_there = std::any_of(rows.begin(), rows.begin() + num_layers,
                                      [&, &id = id](const LayerRow& row) { return row.id == id; });
    if (!is_there) rows.push_back({id, std::nullopt, settings, "", -1});
  }
  return rows;
}

std::string TextOf(const LayerSettings& settings, const std::optional<SessionId>& session) {
  std::vector<std::string> texts;
  if (settings.muted) texts.push_back("muted");
  if (settings.low_weight) texts.push_back("low weight");
  if (settings.shift != KnotShift{}) {
    texts.push_back(fmt::format("shifted by {}, {} knots", settings.shift.i, settings.shift.j));
  }
  // A removal of earlier sessions does not matter to a layer that is there.
  if (settings.removed_up_to > 0 && (!session || settings.IsRemoved(*session))) {
    texts.push_back(fmt::format("removed up to session {}", settings.removed_up_to));
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
  const bool is_live = std::any_of(layers.begin(), layers.end(),
                                   [](const LayerRow& layer) { return !layer.state.empty(); });
  std::string table;
  for (const TableRow& row : rows) {
    std::string text;
    for (size_t k = 0; k < row.size(); ++k) {
      if (!is_live && (k == 1 || k == 2)) continue;  // state, heard_s
      const bool is_number = k > 1 && k < 7;
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
  nlohmann::json json = {
      {"name", row.id.name},
      {"origin", fmt::format("{:016x}", row.id.origin)},
      {"muted", settings.muted},
      {"low_weight", settings.low_weight},
      {"shift_knots", {settings.shift.i, settings.shift.j}},
      {"removed_up_to", settings.removed_up_to},
      {"in_sum", row.content.has_value() && settings.IsSummed()},
  };
  if (!row.state.empty()) {
    json["state"] = row.state;
    json["heard_s_ago"] = row.heard_s_ago;
  }
  if (!row.content) return json;
  const LayerRow::Content& content = *row.content;
  json["session_number"] = content.session.number;
  json["session_nonce"] = fmt::format("{:016x}", content.session.nonce);
  json["commits"] = content.revision;
  json["tiles"] = content.tiles;
  json["area_m2"] = content.area_m2;
  if (const auto& box = content.box) json["box_m"] = {box->x0_m, box->y0_m, box->x1_m, box->y1_m};
  json["hash"] = fmt::format("{:016x}", content.hash);
  return json;
}

}  // namespace splinemap
