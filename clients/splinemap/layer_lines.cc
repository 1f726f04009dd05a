#include "clients/splinemap/layer_lines.h"

#include <algorithm>
#include <array>

#include "clients/splinemap/layer_name.h"
#include "clients/splinemap/live_layers.h"
#include "fmt/format.h"
#include "fmt/ranges.h"
#include "lib/base/plain_text.h"
#include "lib/map/tile_update.h"

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

bool IsAligned(const LayerControl& control) { return control.alignment != std::array<double, 3>{}; }

constexpr std::array kHeader{"layer", "state",   "heard_s", "start", "commits",
                             "tiles", "area_m2", "box_m",   "hash",  "decided"};
using TableRow = std::array<std::string, kHeader.size()>;

TableRow RowOf(const LayerLine& line) {
  TableRow row;
  row.fill("-");
  row.front() = NameOf(line.id);
  row.back() =
      TextOf(line.control, line.content ? std::optional(line.content->epoch) : std::nullopt);
  if (!line.state.empty()) row[1] = PlainText(line.state);
  if (line.heard_s_ago >= 0) row[2] = fmt::format("{:.1f}", line.heard_s_ago);
  if (!line.content) return row;
  const LayerLine::Content& content = *line.content;
  row[3] = fmt::to_string(content.epoch.incarnation);
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

LayerLine LineOf(const layer_status_t& layer) {
  LayerLine line{{layer.name, static_cast<uint64_t>(layer.origin)},
                 std::nullopt,
                 ControlOf(layer),
                 layer.state,
                 layer.heard_s_ago};
  if (layer.state == "removed") return line;
  line.content = LayerLine::Content{
      {static_cast<uint64_t>(layer.incarnation), static_cast<uint64_t>(layer.nonce)},
      static_cast<uint64_t>(layer.revision),
      static_cast<size_t>(layer.num_tiles),
      layer.area_m2,
      std::nullopt,
      static_cast<uint64_t>(layer.hash)};
  if (layer.num_tiles > 0) {
    line.content->box = Region{layer.x0_m, layer.y0_m, layer.x1_m, layer.y1_m};
  }
  return line;
}

LayerLine LineOf(const LayerSnapshot& layer, const LayerControl& control, double knot_interval_m) {
  LayerLine::Content content{layer.epoch, layer.revision, layer.tiles.size(), 0, std::nullopt, 0};
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
  if (known > 0) content.box = RegionOf(box, control.shift, knot_interval_m);
  return {layer.id, content, control, "", -1};
}

std::vector<LayerLine> LinesOf(const MapSnapshot& map) {
  std::vector<LayerLine> lines;
  for (const LayerSnapshot& layer : map.layers) {
    lines.push_back(LineOf(layer, map.controls.Of(layer.id), map.options.knot_interval_m));
  }
  const size_t num_layers = lines.size();
  for (const auto& [id, control] : map.controls.records()) {
    const bool is_there =
        std::any_of(lines.begin(), lines.begin() + num_layers,
                    [&, &id = id](const LayerLine& line) { return line.id == id; });
    if (!is_there) lines.push_back({id, std::nullopt, control, "", -1});
  }
  return lines;
}

std::string TextOf(const LayerControl& control, const std::optional<LayerEpoch>& epoch) {
  std::vector<std::string> decisions;
  if (control.muted) decisions.push_back("muted");
  if (control.yields) decisions.push_back("yields");
  if (control.shift != KnotShift{}) {
    decisions.push_back(fmt::format("shifted by {}, {} knots", control.shift.i, control.shift.j));
  }
  if (IsAligned(control)) {
    decisions.push_back(fmt::format("turned and moved by {} m, {} m, {} rad, and so left out",
                                    control.alignment[0], control.alignment[1],
                                    control.alignment[2]));
  }
  // Of a layer that is there, what matters is whether it was removed, not what was before it.
  if (control.removed_up_to > 0 && (!epoch || control.IsRemoved(*epoch))) {
    decisions.push_back(fmt::format("removed up to start {}", control.removed_up_to));
  }
  return fmt::format("{}", fmt::join(decisions, ", "));
}

std::string TableOf(const std::vector<LayerLine>& lines) {
  std::vector<TableRow> rows(1);
  std::copy(kHeader.begin(), kHeader.end(), rows.front().begin());
  for (const LayerLine& line : lines) rows.push_back(RowOf(line));
  std::array<size_t, kHeader.size()> widths{};
  for (const TableRow& row : rows) {
    for (size_t k = 0; k < row.size(); ++k) widths[k] = std::max(widths[k], row[k].size());
  }
  const bool is_live = std::any_of(lines.begin(), lines.end(),
                                   [](const LayerLine& line) { return !line.state.empty(); });
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

nlohmann::json ToJson(const LayerLine& line) {
  const LayerControl& control = line.control;
  nlohmann::json json = {
      {"name", line.id.name},
      {"origin", fmt::format("{:016x}", line.id.origin)},
      {"muted", control.muted},
      {"yields", control.yields},
      {"shift_knots", {control.shift.i, control.shift.j}},
      {"alignment", control.alignment},
      {"removed_up_to", control.removed_up_to},
      {"in_sum", line.content.has_value() && control.IsSummed()},
  };
  if (!line.state.empty()) {
    json["state"] = line.state;
    json["heard_s_ago"] = line.heard_s_ago;
  }
  if (!line.content) return json;
  const LayerLine::Content& content = *line.content;
  json["incarnation"] = content.epoch.incarnation;
  json["nonce"] = fmt::format("{:016x}", content.epoch.nonce);
  json["commits"] = content.revision;
  json["tiles"] = content.tiles;
  json["area_m2"] = content.area_m2;
  if (const auto& box = content.box) json["box_m"] = {box->x0_m, box->y0_m, box->x1_m, box->y1_m};
  json["hash"] = fmt::format("{:016x}", content.hash);
  return json;
}

}  // namespace splinemap
