#include "services/viewer/http_api.h"

#include <cmath>
#include <nlohmann/json.hpp>
#include <numbers>

#include "absl/strings/numbers.h"
#include "absl/strings/str_split.h"
#include "lib/base/status.h"
#include "lib/render/raster.h"
#include "services/viewer/state_json.h"
#include "splinemap/pose2.h"

namespace splinemap {
namespace {

using Eigen::Vector2d;
using nlohmann::json;

const char* NameOf(Occupancy occupancy) {
  switch (occupancy) {
    case Occupancy::kFree:
      return "free";
    case Occupancy::kOccupied:
      return "occupied";
    default:
      return "unknown";
  }
}

HttpAnswer JsonAnswer(const json& body) {
  return {.body = body.dump(-1, ' ', false, json::error_handler_t::replace) + "\n"};
}

json ToJson(const Vector2d& vector) { return {vector.x(), vector.y()}; }

absl::StatusOr<Vector2d> PointOf(const HttpTarget& target, const std::string& x,
                                 const std::string& y) {
  Vector2d point_m;
  SPLINEMAP_ASSIGN_OR_RETURN(point_m.x(), target.Number(x));
  SPLINEMAP_ASSIGN_OR_RETURN(point_m.y(), target.Number(y));
  return point_m;
}

// What one layer says at a point of the map.
json ValueOf(const LayerSet& set, const LayerSnapshot& layer, const Vector2d& point_m) {
  const LayerSettings& settings = set.settings.Of(layer.id);
  MapView alone;
  alone.options = set.options;
  alone.tiles = layer.tiles;
  const Vector2d in_layer_m = Inverse(settings.placement.ToPose()) * point_m;
  const SurfaceSample sample = alone.Evaluate(in_layer_m.x(), in_layer_m.y());
  return {{"key", KeyOf(layer.id)},
          {"name", layer.id.name},
          {"known", sample.known},
          {"log_odds", sample.log_odds},
          {"is_summed", settings.IsSummed()}};
}

}  // namespace

HttpAnswer ErrorAnswer(const absl::Status& status) {
  HttpAnswer answer = JsonAnswer({{"error", ErrorText(status)}});
  switch (status.code()) {
    case absl::StatusCode::kUnauthenticated:
      answer.status = 401;
      break;
    case absl::StatusCode::kPermissionDenied:
      answer.status = 403;
      break;
    case absl::StatusCode::kNotFound:
      answer.status = 404;
      break;
    case absl::StatusCode::kInvalidArgument:
    case absl::StatusCode::kFailedPrecondition:
      answer.status = 400;
      break;
    default:
      answer.status = 503;
  }
  return answer;
}

HttpAnswer HttpApi::Get(const HttpTarget& target) const {
  absl::StatusOr<HttpAnswer> answer = Answer(target);
  return answer.ok() ? *std::move(answer) : ErrorAnswer(answer.status());
}

absl::StatusOr<HttpAnswer> HttpApi::Answer(const HttpTarget& target) const {
  if (target.path == "/api/query") return Query(target);
  if (target.path == "/api/ray") return Ray(target);
  if (target.path == "/api/distance") return Distance(target);
  if (target.path == "/api/check") return Check(target);
  if (target.path == "/map.png") return Picture(target);
  if (target.path.starts_with("/tiles/")) return WebTile(target);
  return NotFound("there is nothing at {}", target.path);
}

absl::StatusOr<HttpAnswer> HttpApi::Query(const HttpTarget& target) const {
  SPLINEMAP_ASSIGN_OR_RETURN(const Vector2d point_m, PointOf(target, "x", "y"));
  SPLINEMAP_ASSIGN_OR_RETURN(const PointsQuery::Answer answer,
                             map_.map().Ask(PointsQuery{{point_m}}));
  const SurfaceSample& sample = answer.samples[0];
  json layers = json::array();
  const LayerSet set = map_.Layers();
  for (const LayerSnapshot& layer : set.layers) layers.push_back(ValueOf(set, layer, point_m));
  return JsonAnswer({{"x_m", point_m.x()},
                     {"y_m", point_m.y()},
                     {"revision", answer.revision},
                     {"known", sample.known},
                     {"log_odds", sample.log_odds},
                     {"probability", Probability(sample.log_odds)},
                     {"gradient_per_m", ToJson(sample.gradient_per_m)},
                     {"layers", std::move(layers)}});
}

absl::StatusOr<HttpAnswer> HttpApi::Ray(const HttpTarget& target) const {
  splinemap::Ray ray;
  SPLINEMAP_ASSIGN_OR_RETURN(ray.origin_m, PointOf(target, "x", "y"));
  SPLINEMAP_ASSIGN_OR_RETURN(const double bearing_deg, target.Number("bearing_deg"));
  SPLINEMAP_ASSIGN_OR_RETURN(ray.max_range_m, target.NumberOr("range", 30));
  ray.bearing_rad = bearing_deg * std::numbers::pi / 180;
  RaysQuery query;
  query.rays = {ray};
  SPLINEMAP_ASSIGN_OR_RETURN(const RaysQuery::Answer answer, map_.map().Ask(query));
  const RaysQuery::End& end = answer.ends[0];
  const Vector2d end_m =
      ray.origin_m + end.range_m * Vector2d(std::cos(ray.bearing_rad), std::sin(ray.bearing_rad));
  return JsonAnswer({{"occupancy", NameOf(end.occupancy)},
                     {"range_m", end.range_m},
                     {"x_m", end_m.x()},
                     {"y_m", end_m.y()}});
}

absl::StatusOr<HttpAnswer> HttpApi::Distance(const HttpTarget& target) const {
  DistancesQuery query;
  SPLINEMAP_ASSIGN_OR_RETURN(query.points_m.emplace_back(), PointOf(target, "x", "y"));
  SPLINEMAP_ASSIGN_OR_RETURN(query.max_distance_m, target.NumberOr("max", query.max_distance_m));
  SPLINEMAP_ASSIGN_OR_RETURN(const DistancesQuery::Answer answer, map_.map().Ask(query));
  const DistancesQuery::Distance& distance = answer.distances[0];
  return JsonAnswer({{"distance_m", distance.distance_m}, {"gradient", ToJson(distance.gradient)}});
}

absl::StatusOr<HttpAnswer> HttpApi::Check(const HttpTarget& target) const {
  SweepsQuery query;
  Sweep& sweep = query.sweeps.emplace_back();
  SPLINEMAP_ASSIGN_OR_RETURN(sweep.path_m.emplace_back(), PointOf(target, "x0", "y0"));
  SPLINEMAP_ASSIGN_OR_RETURN(sweep.path_m.emplace_back(), PointOf(target, "x1", "y1"));
  SPLINEMAP_ASSIGN_OR_RETURN(sweep.radius_m, target.Number("radius"));
  SPLINEMAP_ASSIGN_OR_RETURN(const SweepsQuery::Answer answer, map_.map().Ask(query));
  const SweepsQuery::Result& result = answer.results[0];
  json contact;
  if (result.occupancy != Occupancy::kFree)
    contact = {{"x_m", result.contact_m.x()}, {"y_m", result.contact_m.y()}};
  return JsonAnswer({{"occupancy", NameOf(result.occupancy)},
                     {"is_certified", result.is_certified},
                     {"free_m", result.free_m},
                     {"contact", std::move(contact)}});
}

absl::StatusOr<HttpAnswer> HttpApi::Render(double left_m, double top_m, double pixel_m, int width,
                                           int height) const {
  const SumLevels::Shown shown = sum_.ForPixels(pixel_m);
  const PixelGrid grid{width, height, left_m - shown.offset_m, top_m - shown.offset_m, pixel_m};
  SPLINEMAP_ASSIGN_OR_RETURN(std::string png, EncodePng(RenderMap(shown.map, grid)));
  return HttpAnswer{.content_type = "image/png", .body = std::move(png)};
}

absl::StatusOr<HttpAnswer> HttpApi::Picture(const HttpTarget& target) const {
  const auto bbox = target.parameters.find("bbox");
  const std::vector<std::string> sides = bbox == target.parameters.end()
                                             ? std::vector<std::string>()
                                             : absl::StrSplit(bbox->second, ',');
  std::array<double, 4> box{};
  bool is_box = sides.size() == box.size();
  for (size_t k = 0; is_box && k < box.size(); ++k)
    is_box = absl::SimpleAtod(sides[k], &box[k]) && std::abs(box[k]) < 1e9;
  const double width_m = box[2] - box[0];
  const double height_m = box[3] - box[1];
  if (!is_box || !(width_m > 0 && height_m > 0)) {
    return InvalidArgument(
        "bbox is x0,y0,x1,y1 in metres, the lower left corner first: "
        "/map.png?bbox=-5,-5,20,20&px=800");
  }
  SPLINEMAP_ASSIGN_OR_RETURN(const double px, target.Number("px"));
  const double height = std::ceil(px * height_m / width_m);
  if (!(px >= 1 && px <= kMaxPictureSide && height >= 1 && height <= kMaxPictureSide)) {
    return InvalidArgument("a picture has 1 to {} pixels each way, not {} x {}", kMaxPictureSide,
                           px, height);
  }
  const int width = static_cast<int>(px);
  return Render(box[0], box[3], width_m / width, width, static_cast<int>(height));
}

// XYZ tiles of web maps, whose metres (EPSG:3857) are taken for those of the map frame.
absl::StatusOr<HttpAnswer> HttpApi::WebTile(const HttpTarget& target) const {
  constexpr double kHalfWorld_m = 20'037'508.342789244;
  constexpr int kPixels = 256;
  constexpr int kMaxZoom = 26;
  const std::vector<std::string> parts = absl::StrSplit(target.path, '/');
  int z = 0;
  int64_t x = 0;
  int64_t y = 0;
  const bool is_tile = parts.size() == 5 && parts[4].ends_with(".png") &&
                       absl::SimpleAtoi(parts[2], &z) && absl::SimpleAtoi(parts[3], &x) &&
                       absl::SimpleAtoi(parts[4].substr(0, parts[4].size() - 4), &y) && z >= 0 &&
                       z <= kMaxZoom && x >= 0 && x < int64_t{1} << z && y >= 0 &&
                       y < int64_t{1} << z;
  if (!is_tile) return NotFound("there is no tile {}; they are /tiles/ZOOM/X/Y.png", target.path);
  const double side_m = std::ldexp(2 * kHalfWorld_m, -z);
  return Render(static_cast<double>(x) * side_m - kHalfWorld_m,
                kHalfWorld_m - static_cast<double>(y) * side_m, side_m / kPixels, kPixels, kPixels);
}

}  // namespace splinemap
