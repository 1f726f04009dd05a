#include "services/viewer/state_json.h"

#include <cmath>
#include <map>
#include <nlohmann/json.hpp>

#include "fmt/format.h"
#include "lib/map/placed_tile.h"

namespace splinemap {
namespace {

using nlohmann::json;

// Texts of a bus may be no UTF-8.
std::string Dump(const json& value) {
  return value.dump(-1, ' ', false, json::error_handler_t::replace);
}

// Whole ones: what ages does not make news at every frame.
double SecondsSince(Clock::time_point time) {
  return std::floor(std::chrono::duration<double>(Clock::now() - time).count());
}

json NumberOrNull(double value) { return std::isfinite(value) ? json(value) : json(); }

// To the millimetre, which is less than a pixel.
double Rounded(double coordinate_m) { return std::round(coordinate_m * 1000) / 1000; }

json ToJson(const Region& region) {
  return {
      {"x0_m", region.x0_m}, {"y0_m", region.y0_m}, {"x1_m", region.x1_m}, {"y1_m", region.y1_m}};
}

json ToJson(const std::vector<Eigen::Vector2d>& points_m) {
  json numbers = json::array();
  for (const Eigen::Vector2d& point_m : points_m) {
    numbers.push_back(Rounded(point_m.x()));
    numbers.push_back(Rounded(point_m.y()));
  }
  return numbers;
}

// What daemons say of a layer beyond what is in it.
void AddStatus(const BusLayer& layer, Clock::time_point heard, json& row) {
  const layer_status_t& status = layer.status;
  row["state"] = status.state;
  row["contradicted"] = NumberOrNull(status.contradicted);
  row["heard_s_ago"] =
      status.heard_s_ago < 0 ? -1 : std::floor(status.heard_s_ago) + SecondsSince(heard);
  if (status.area_m2 > 0) {
    row["bounds"] = ToJson(Region{status.x0_m, status.y0_m, status.x1_m, status.y1_m});
  }
}

}  // namespace

std::string KeyOf(const LayerId& id) { return fmt::format("{}@{:016x}", id.name, id.origin); }

std::string MapJson(const MapFacts& facts, const ShownMap& map, const MapView& view,
                    const TileBox& box) {
  return Dump(
      {{"source", facts.source},
       {"name", facts.name},
       {"knot_interval_m", view.options.knot_interval_m},
       {"min_log_odds", view.options.limits.min / double{kUnitsPerLogOdds}},
       {"max_log_odds", view.options.limits.max / double{kUnitsPerLogOdds}},
       {"revision", view.revision},
       {"tiles", view.tiles.size()},
       {"bounds",
        view.tiles.size() == 0 ? json() : ToJson(RegionOf(box, view.options.knot_interval_m))},
       {"allows_commands", facts.allows_commands},
       {"is_caught_up", map.IsCaughtUp()},
       {"problem", map.Problem()},
       {"refused", map.Refused()},
       {"version", SPLINEMAP_VERSION}});
}

std::string LayersJson(const ShownMap& map, const BusState* bus) {
  const LayerSet set = map.Layers();
  std::map<LayerId, FollowedLayer> followed;
  for (FollowedLayer& layer : map.FollowedLayers()) followed[layer.id] = std::move(layer);
  json rows = json::array();
  for (const LayerSnapshot& layer : set.layers) {
    const LayerSettings& settings = set.settings.Of(layer.id);
    const Pose2 placement = settings.placement.ToPose();
    json row = {{"key", KeyOf(layer.id)},
                {"name", layer.id.name},
                {"origin", fmt::format("{:016x}", layer.id.origin)},
                {"state", bus == nullptr ? "file" : "stale"},
                {"is_muted", settings.muted},
                {"is_low_weight", settings.low_weight},
                {"placement",
                 {{"x_m", placement.position_m.x()},
                  {"y_m", placement.position_m.y()},
                  {"yaw_rad", placement.yaw_rad}}},
                {"is_approximate", IsApproximate(settings.placement, set.options.knot_interval_m)},
                {"tiles", layer.tiles.size()},
                {"caught_up", true},
                {"staleness_ms", 0},
                {"heard_s_ago", -1},
                {"contradicted", -1},
                {"bounds", json()}};
    if (const auto copy = followed.find(layer.id); copy != followed.end()) {
      row["caught_up"] = copy->second.caught_up;
      // Whole tenths of a second, so that it makes no news at every frame.
      row["staleness_ms"] = NumberOrNull(std::ceil(copy->second.staleness_ms / 100) * 100);
      row["heard_s_ago"] = std::floor(copy->second.heard_s_ago);
      row["state"] = copy->second.owner_is_silent ? "gone"
                     : copy->second.caught_up     ? "live"
                                                  : "stale";
    }
    if (bus != nullptr) {
      const auto status = bus->layers.find(layer.id);
      if (status != bus->layers.end() && SecondsSince(status->second.time) < 3)
        AddStatus(status->second.value, status->second.time, row);
    }
    rows.push_back(std::move(row));
  }
  return Dump(rows);
}

std::string TimesJson(const MapTimes& times) {
  const auto to_json = [](std::optional<Utime> utime) {
    return utime ? json(utime->count()) : json();
  };
  return Dump({{"first_utime", times.first.count()},
               {"last_utime", times.last.count()},
               {"shown_utime", to_json(times.shown)},
               {"wanted_utime", to_json(times.wanted)},
               {"problem", times.problem}});
}

std::string DaemonsJson(const BusState& bus, Clock::time_point asked_since) {
  json rows = json::array();
  for (const auto& [nonce, heard] : bus.daemons) {
    const status_t& status = heard.value;
    json drops = json::array();
    for (size_t k = 0; k < status.drop_reasons.size(); ++k)
      drops.push_back({{"reason", status.drop_reasons[k]}, {"count", status.drop_counts[k]}});
    json problems = json::array();
    for (size_t k = 0; k < status.problems.size(); ++k)
      problems.push_back({{"name", status.problems[k]}, {"count", status.problem_counts[k]}});
    rows.push_back({{"key", fmt::format("{:016x}", static_cast<uint64_t>(nonce))},
                    {"name", status.name},
                    {"version", status.version},
                    {"uptime_s", NumberOrNull(status.uptime_s)},
                    {"scans_received", status.scans_received},
                    {"poses_received", status.poses_received},
                    {"scans_mapped", status.scans_mapped},
                    {"newest_scan_age_s", NumberOrNull(status.newest_scan_age_s)},
                    {"messages_dropped", status.messages_dropped},
                    {"drops", std::move(drops)},
                    {"problems", std::move(problems)},
                    {"last_problem", status.last_problem},
                    {"heard_s_ago", SecondsSince(std::max(heard.time, asked_since))},
                    {"revision", status.revision},
                    {"saved_revision", status.saved_revision}});
  }
  return Dump(rows);
}

Pose2 MapFromPoses(const BusState& bus, const SettingsTable& settings) {
  const Heard<status_t>* robot = nullptr;
  for (const auto& [nonce, daemon] : bus.daemons) {
    if (daemon.value.poses_received == 0) continue;
    if (robot != nullptr && robot->value.name != daemon.value.name) return {};
    if (robot == nullptr || robot->time < daemon.time) robot = &daemon;
  }
  if (robot == nullptr) return {};
  const LayerId id{robot->value.name, static_cast<uint64_t>(robot->value.origin)};
  const auto frame = bus.frames.find(id);
  if (frame == bus.frames.end()) return {};
  return settings.Of(id).placement.ToPose() * frame->second.value;
}

std::string PosesJson(const BusState& bus, const Pose2& map_T_poses) {
  json rows = json::array();
  for (const auto& [channel, heard] : bus.poses) {
    const Pose2 pose = map_T_poses * heard.value;
    rows.push_back({{"channel", channel},
                    {"x_m", Rounded(pose.position_m.x())},
                    {"y_m", Rounded(pose.position_m.y())},
                    {"yaw_rad", WrapAngle(pose.yaw_rad)},
                    {"heard_s_ago", SecondsSince(heard.time)}});
  }
  return Dump(rows);
}

std::string ScansJson(const BusState& bus, const Pose2& map_T_poses) {
  json rows = json::array();
  for (const auto& [channel, heard] : bus.scans) {
    const Eigen::Vector2d sensor_m = map_T_poses * heard.value.sensor_m;
    std::vector<Eigen::Vector2d> hits_m = heard.value.hits_m;
    for (Eigen::Vector2d& hit_m : hits_m) hit_m = map_T_poses * hit_m;
    rows.push_back({{"channel", channel},
                    {"sensor", {{"x_m", Rounded(sensor_m.x())}, {"y_m", Rounded(sensor_m.y())}}},
                    {"points_m", ToJson(hits_m)},
                    {"heard_s_ago", SecondsSince(heard.time)}});
  }
  return Dump(rows);
}

std::string PathsJson(const BusState& bus) {
  json rows = json::array();
  for (const auto& [channel, heard] : bus.paths) {
    rows.push_back({{"channel", channel},
                    {"points_m", ToJson(heard.value)},
                    {"heard_s_ago", SecondsSince(heard.time)}});
  }
  return Dump(rows);
}

}  // namespace splinemap
