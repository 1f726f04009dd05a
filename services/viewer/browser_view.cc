#include "services/viewer/browser_view.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstring>
#include <limits>
#include <nlohmann/json.hpp>
#include <utility>

#include "lib/base/status.h"
#include "splinemap/level_of_detail.h"

namespace splinemap {
namespace {

using nlohmann::json;

static_assert(std::endian::native == std::endian::little);

absl::StatusOr<ViewRequest> RequestOf(const json& view) {
  ViewRequest request;
  request.region = {view.at("x0_m").get<double>(), view.at("y0_m").get<double>(),
                    view.at("x1_m").get<double>(), view.at("y1_m").get<double>()};
  if (!view.at("level").is_number_integer()) return InvalidArgument("a level is a whole number");
  request.level = static_cast<int>(std::clamp<int64_t>(view["level"].get<int64_t>(), -1, 100));
  request.surfaces = view.at("surfaces").get<std::vector<std::string>>();
  const Region& region = request.region;
  for (const double side : {region.x0_m, region.y0_m, region.x1_m, region.y1_m}) {
    if (!std::isfinite(side)) return InvalidArgument("a view that is not finite");
  }
  if (region.x0_m > region.x1_m || region.y0_m > region.y1_m)
    return InvalidArgument("a view whose sides are the wrong way round");
  if (request.level < 0 || request.level > LevelOfDetail::kMaxLevel)
    return InvalidArgument("there is no level {}", request.level);
  if (request.surfaces.size() > ViewRequest::kMaxSurfaces)
    return InvalidArgument("a view has at most {} surfaces", ViewRequest::kMaxSurfaces);
  return request;
}

absl::StatusOr<TimeRequest> TimeRequestOf(const json& utime) {
  if (utime.is_null()) return TimeRequest{};
  if (!utime.is_number_integer()) return InvalidArgument("a time is a whole number of us, or null");
  constexpr uint64_t kMost = std::numeric_limits<int64_t>::max();
  const bool is_beyond = utime.is_number_unsigned() && utime.get<uint64_t>() > kMost;
  return TimeRequest{Utime(is_beyond ? int64_t{kMost} : utime.get<int64_t>())};
}

// The tiles of the request, cut to kMaxTiles about their middle.
TileBox TilesOf(const ViewRequest& request, double knot_interval_m) {
  TileBox box = TilesOf(request.region, knot_interval_m * std::ldexp(1, request.level));
  constexpr int32_t kMaxSide = 256;
  const auto cut = [](int32_t& begin, int32_t& end, int64_t size) {
    if (int64_t{end} - begin <= size) return;
    begin = static_cast<int32_t>((int64_t{begin} + end - size) / 2);
    end = static_cast<int32_t>(begin + size);
  };
  cut(box.tx0, box.tx1, kMaxSide);
  cut(box.ty0, box.ty1, ViewRequest::kMaxTiles / std::max(1, box.tx1 - box.tx0));
  return box;
}

}  // namespace

absl::Status BrowserView::Handle(std::string_view message) {
  time_request_.reset();
  const json parsed = json::parse(message, nullptr, /*allow_exceptions=*/false);
  if (!parsed.is_object()) return InvalidArgument("a message that is no JSON object");
  try {
    if (parsed.contains("ack")) {
      if (!parsed["ack"].is_number_integer()) return InvalidArgument("ack is no number of a frame");
      const auto frame = parsed["ack"].get<int64_t>();
      if (frame > acknowledged_ && frame <= frame_) acknowledged_ = frame;
    }
    if (parsed.contains("at_utime")) {
      SPLINEMAP_ASSIGN_OR_RETURN(time_request_, TimeRequestOf(parsed["at_utime"]));
    }
    if (!parsed.contains("view")) return absl::OkStatus();
    SPLINEMAP_ASSIGN_OR_RETURN(ViewRequest request, RequestOf(parsed["view"]));
    return SetRequest(std::move(request));
  } catch (const json::exception& error) {
    return InvalidArgument("a message of another form: {}", error.what());
  }
}

absl::Status BrowserView::SetRequest(ViewRequest request) {
  const bool is_same_kind =
      request_ && request_->level == request.level && request_->surfaces == request.surfaces;
  // A view that was never looked at may be what the page has forgotten tiles for.
  if (!is_same_kind || is_request_new_) sent_.clear();
  request_ = std::move(request);
  is_request_new_ = true;
  sent_up_to_.assign(request_->surfaces.size(), 0);
  return absl::OkStatus();
}

std::vector<BrowserView::Wanted> BrowserView::FindWanted(double knot_interval_m,
                                                         const FindSurface& find) {
  std::vector<Wanted> wanted;
  const TileBox box = TilesOf(*request_, knot_interval_m);
  for (size_t n = 0; n < request_->surfaces.size(); ++n) {
    const int surface = static_cast<int>(n);
    const SurfaceLevels* levels = find(request_->surfaces[n]);
    if (levels == nullptr) continue;
    if (is_request_new_) {
      // What the page does not see any more it forgets.
      absl::erase_if(sent_, [&](const auto& entry) {
        return std::get<0>(entry.first) == surface && !box.Contains(std::get<1>(entry.first));
      });
    }
    const uint64_t newest = levels->newest_change(request_->level);
    if (sent_up_to_[n] == newest) continue;
    const double centre_x = (box.tx0 + box.tx1 - 1) / 2.0;
    const double centre_y = (box.ty0 + box.ty1 - 1) / 2.0;
    const size_t before = wanted.size();
    for (int32_t ty = box.ty0; ty < box.ty1; ++ty) {
      for (int32_t tx = box.tx0; tx < box.tx1; ++tx) {
        const SurfaceLevels::Change* change = levels->FindChange(request_->level, {tx, ty});
        if (change == nullptr) continue;
        const auto sent = sent_.find({surface, {tx, ty}});
        if (sent != sent_.end() && sent->second == change->number) continue;
        wanted.push_back({surface, {tx, ty}, change, std::hypot(tx - centre_x, ty - centre_y)});
      }
    }
    if (wanted.size() == before) sent_up_to_[n] = newest;
  }
  std::stable_sort(wanted.begin(), wanted.end(),
                   [](const Wanted& a, const Wanted& b) { return a.distance < b.distance; });
  return wanted;
}

std::optional<std::string> BrowserView::NextFrame(const Sections& sections, double knot_interval_m,
                                                  const FindSurface& find, TileBodies& bodies) {
  if (acknowledged_ != frame_) return std::nullopt;
  std::string text = fmt::format("{{\"frame\":{}", frame_ + 1);
  bool has_news = false;
  for (int name = 0; name < Sections::kCount; ++name) {
    const uint64_t number = sections.numbers()[name];
    if (std::exchange(sent_sections_[name], number) == number) continue;
    text += fmt::format(",\"{}\":{}", Sections::kNames[name], sections.json(name));
    has_news = true;
  }
  std::string tiles;
  if (request_) {
    const std::vector<Wanted> wanted = FindWanted(knot_interval_m, find);
    const bool tells_complete = std::exchange(is_request_new_, false) || !is_complete_;
    if (!wanted.empty() || tells_complete) {
      has_news = true;
      text += fmt::format(
          ",\"tiles\":{{\"level\":{},\"surfaces\":{},\"list\":[", request_->level,
          json(request_->surfaces).dump(-1, ' ', false, json::error_handler_t::replace));
      size_t count = 0;
      for (const Wanted& tile : wanted) {
        if (tiles.size() >= kMaxFrameBytes) break;
        const SurfaceLevels& levels = *find(request_->surfaces[tile.surface]);
        const auto content = levels.tiles(request_->level).Share(tile.key);
        const size_t begin = tiles.size();
        if (content != nullptr && *content->Get() != Tile()) tiles += bodies.Of(content);
        text += fmt::format("{}[{},{},{},{},{}]", count == 0 ? "" : ",", tile.surface, tile.key.tx,
                            tile.key.ty, tiles.size() - begin, tile.change->utime_ms);
        sent_[{tile.surface, tile.key}] = tile.change->number;
        ++count;
      }
      is_complete_ = count == wanted.size();
      text += fmt::format("],\"is_complete\":{}}}", is_complete_);
    }
  }
  if (!has_news) return std::nullopt;
  text += "}";
  ++frame_;
  const auto length = static_cast<uint32_t>(text.size());
  std::string frame(sizeof(length), '\0');
  std::memcpy(frame.data(), &length, sizeof(length));
  return frame + text + tiles;
}

}  // namespace splinemap
