#include "services/viewer/viewer.h"

#include <algorithm>
#include <boost/asio/co_spawn.hpp>
#include <boost/asio/detached.hpp>
#include <boost/asio/post.hpp>
#include <cmath>
#include <nlohmann/json.hpp>
#include <utility>  // before Boost 1.74, which lacks it

#include "lib/base/host_clock.h"
#include "lib/base/status.h"
#include "services/viewer/into.h"
#include "splinemap/client.h"

namespace splinemap {
namespace {

namespace asio = boost::asio;
using nlohmann::json;
using std::chrono::milliseconds;

constexpr milliseconds kMinInterval(20);    // between frames
constexpr milliseconds kMaxInterval(1000);  // ages are shown
constexpr milliseconds kWorkInterval(1);
constexpr size_t kTilesAtOnce = 1000;  // some ms of work on coarser levels
constexpr const char* kSum = "sum";
constexpr const char* kFile = "file";
constexpr const char* kFleet = "fleet";

absl::StatusOr<json> ParseBody(const std::string& body) {
  json parsed = json::parse(body, nullptr, /*allow_exceptions=*/false);
  if (!parsed.is_object()) return InvalidArgument("the body is no JSON object");
  return parsed;
}

absl::StatusOr<double> NumberOf(const json& object, const char* name) {
  const auto value = object.find(name);
  constexpr double kMost = 1e9;  // as far as anybody drives
  if (value == object.end() || !value->is_number() || !(std::abs(value->get<double>()) < kMost))
    return InvalidArgument("{} is missing, or no number below 1e9", name);
  return value->get<double>();
}

}  // namespace

absl::StatusOr<std::unique_ptr<Viewer>> Viewer::Open(asio::io_context& io,
                                                     const ViewerOptions& options) {
  std::unique_ptr<Viewer> viewer(new Viewer(io, options));
  const auto nudge = [v = viewer.get()] { v->Nudge(); };
  const std::string& source = viewer->facts_.source;
  if (source == kFile) {
    SPLINEMAP_ASSIGN_OR_RETURN(viewer->map_, OpenMap(options.map, nudge));
  } else if (source == kFleet) {
    SPLINEMAP_ASSIGN_OR_RETURN(viewer->map_, FollowFleet(options.fleet, nudge));
  } else {
    FollowOptions follow;
    follow.channel_prefix = options.watch.channel_prefix;
    follow.keys = options.watch.keys;
    SPLINEMAP_ASSIGN_OR_RETURN(viewer->map_, FollowMap(options.lcm_url, follow, nudge));
    SPLINEMAP_ASSIGN_OR_RETURN(viewer->bus_,
                               BusWatch::Start(options.lcm_url, options.watch, nudge));
  }
  viewer->api_ = std::make_unique<HttpApi>(*viewer->map_, viewer->sum_levels_);
  asio::co_spawn(io, viewer->KeepUpToDate(), asio::detached);
  return viewer;
}

Viewer::Viewer(asio::io_context& io, const ViewerOptions& options)
    : io_(io), options_(options), news_(io) {
  if (!options.map.empty()) {
    facts_ = {kFile, options.map.substr(options.map.rfind('/') + 1)};
  } else if (!options.fleet.servers.empty()) {
    facts_ = {kFleet, options.fleet.map + " of " + options.fleet.servers};
  } else {
    facts_ = {"bus", BusAddress::Parse(options.lcm_url).value_or(BusAddress()).url(),
              options.allows_commands};
  }
}

// First the threads that nudge.
Viewer::~Viewer() {
  bus_.reset();
  api_.reset();
  map_.reset();
}

void Viewer::Nudge() {
  if (!is_nudged_.exchange(true)) asio::post(io_, [this] { news_.cancel(); });
}

asio::awaitable<void> Viewer::KeepUpToDate() {
  boost::system::error_code ignored;
  while (true) {
    is_nudged_ = false;
    bool is_at_work = false;
    try {
      is_at_work = Refresh();
    } catch (const std::exception& error) {  // the memory is full: again with the next news
      fmt::print(stderr, "the map is not brought up to date: {}\n", error.what());
    }
    asio::steady_timer pause(io_, is_at_work ? kWorkInterval : kMinInterval);
    co_await pause.async_wait(Into(ignored));
    if (is_at_work || is_nudged_) continue;
    if (browsers_.empty()) {
      news_.expires_at(asio::steady_timer::time_point::max());
    } else {
      news_.expires_after(kMaxInterval - kMinInterval);
    }
    co_await news_.async_wait(Into(ignored));
  }
}

bool Viewer::Refresh() {
  // First, so that the map of the time that pages are told is there.
  if (const auto times = map_->Times()) sections_.Set(Sections::kTimes, TimesJson(*times));
  const std::shared_ptr<const MapView> view = map_->View();
  knot_interval_m_ = view->options.knot_interval_m;
  const bool is_at_work = AdvanceSurfaces(map_->Layers(), *view);
  metrics_.tiles.Set(static_cast<double>(view->tiles.size()));
  metrics_.revision.Set(static_cast<double>(view->revision));
  metrics_.bytes_from_bus.Set(static_cast<double>(map_->BytesReceived()));
  if (browsers_.empty()) return is_at_work;
  SetSections(*view);
  for (const std::shared_ptr<Browser>& browser : browsers_) browser->wake.cancel();
  return is_at_work;
}

// True where some work on coarser levels is left.
bool Viewer::AdvanceSurfaces(const LayerSet& set, const MapView& view) {
  // A file does not change; what differs at another time is no news.
  const int64_t utime_ms = facts_.source == kFile ? 0 : HostUtime() / 1000;
  std::set<std::string> wanted{kSum};
  for (const std::shared_ptr<Browser>& browser : browsers_) {
    if (!browser->view.request()) continue;
    for (const std::string& name : browser->view.request()->surfaces) wanted.insert(name);
  }
  const auto is_unwanted = [&](const auto& entry) { return !wanted.contains(entry.first); };
  std::erase_if(surfaces_, is_unwanted);
  std::erase_if(placed_, is_unwanted);
  bool is_at_work = surfaces_[kSum].Advance(view.tiles, utime_ms, kTilesAtOnce);
  sum_levels_.Set(surfaces_[kSum], view.options);
  for (const LayerSnapshot& layer : set.layers) {
    const std::string key = KeyOf(layer.id);
    if (!wanted.contains(key)) continue;
    LayerSettings settings;
    settings.placement = set.settings.Of(layer.id).placement;
    LayerSet alone{.options = set.options, .layers = {layer}};
    alone.settings.Merge(layer.id, settings);
    const TileTree placed = placed_[key].Update(alone)->tiles;
    is_at_work |= surfaces_[key].Advance(placed, utime_ms, kTilesAtOnce);
  }
  return is_at_work;
}

void Viewer::SetSections(const MapView& view) {
  sections_.Set(Sections::kMap, MapJson(facts_, *map_, view, surfaces_[kSum].box()));
  if (bus_ == nullptr) {
    sections_.Set(Sections::kLayers, LayersJson(*map_, nullptr));
    return;
  }
  bus_->Call();
  const BusState bus = bus_->State();
  sections_.Set(Sections::kLayers, LayersJson(*map_, &bus));
  sections_.Set(Sections::kDaemons, DaemonsJson(bus, watched_since_));
  const Pose2 map_T_poses = MapFromPoses(bus, map_->Layers().settings);
  sections_.Set(Sections::kPoses, PosesJson(bus, map_T_poses));
  sections_.Set(Sections::kScans, ScansJson(bus, map_T_poses));
  sections_.Set(Sections::kPaths, PathsJson(bus));
}

std::shared_ptr<Viewer::Browser> Viewer::Join() {
  if (browsers_.size() >= kMaxBrowsers) return nullptr;
  const auto browser = std::make_shared<Browser>(io_);
  browsers_.insert(browser);
  metrics_.browsers.Set(static_cast<double>(browsers_.size()));
  // Nobody kept them up to date while nobody looked.
  if (browsers_.size() == 1) {
    watched_since_ = Clock::now();
    SetSections(*map_->View());
  }
  Nudge();
  return browser;
}

void Viewer::Leave(const std::shared_ptr<Browser>& browser) {
  browsers_.erase(browser);
  browser->is_gone = true;
  browser->wake.cancel();
  metrics_.browsers.Set(static_cast<double>(browsers_.size()));
}

absl::Status Viewer::Handle(Browser& browser, std::string_view message) {
  SPLINEMAP_RETURN_IF_ERROR(browser.view.Handle(message));
  if (const auto& request = browser.view.time_request()) {
    map_->ShowAt(request->utime);
    Nudge();
  }
  // A layer that nobody looked at so far is taken up before the page is told that it has all.
  if (const auto& request = browser.view.request()) {
    const LayerSet set = map_->Layers();
    const bool is_new = std::any_of(set.layers.begin(), set.layers.end(), [&](const auto& layer) {
      const std::string key = KeyOf(layer.id);
      return !surfaces_.contains(key) &&
             std::count(request->surfaces.begin(), request->surfaces.end(), key) > 0;
    });
    if (is_new) {
      AdvanceSurfaces(set, *map_->View());
      Nudge();
    }
  }
  browser.wake.cancel();
  return absl::OkStatus();
}

std::optional<std::string> Viewer::NextFrame(Browser& browser) {
  std::optional<std::string> frame = browser.view.NextFrame(
      sections_, knot_interval_m_,
      [this](const std::string& name) {
        const auto surface = surfaces_.find(name);
        return surface == surfaces_.end() ? nullptr : &surface->second;
      },
      bodies_);
  if (frame) {
    metrics_.frames.Increment();
    metrics_.frame_bytes.Increment(static_cast<double>(frame->size()));
  }
  return frame;
}

HttpAnswer Viewer::Get(const HttpTarget& target) const {
  if (target.path == "/metrics")
    return {.content_type = "text/plain; version=0.0.4", .body = metrics_.Text()};
  return api_->Get(target);
}

HttpAnswer Viewer::Post(const HttpTarget& target, const std::string& body) {
  const absl::Status status = Execute(target, body);
  if (!status.ok()) return ErrorAnswer(status);
  return {.body = "{}\n"};
}

absl::Status Viewer::Execute(const HttpTarget& target, const std::string& body) {
  if (target.path != "/api/goal" && target.path != "/api/mute")
    return NotFound("there is no command {}", target.path);
  if (bus_ == nullptr)
    return FailedPrecondition("the map of a {} takes no commands", facts_.source);
  if (!options_.allows_commands) {
    return absl::PermissionDeniedError(
        "commands are not allowed; start splinemap-viewer with --allow-commands");
  }
  return target.path == "/api/goal" ? SendGoal(body) : Mute(body);
}

absl::Status Viewer::SendGoal(const std::string& body) {
  SPLINEMAP_ASSIGN_OR_RETURN(const json goal, ParseBody(body));
  Pose2 pose;
  SPLINEMAP_ASSIGN_OR_RETURN(pose.position_m.x(), NumberOf(goal, "x_m"));
  SPLINEMAP_ASSIGN_OR_RETURN(pose.position_m.y(), NumberOf(goal, "y_m"));
  SPLINEMAP_ASSIGN_OR_RETURN(pose.yaw_rad, NumberOf(goal, "yaw_rad"));
  bus_->PublishGoal(options_.goal_channel, pose);
  return absl::OkStatus();
}

absl::Status Viewer::Mute(const std::string& body) {
  SPLINEMAP_ASSIGN_OR_RETURN(const json wish, ParseBody(body));
  const json key = wish.value("layer", json());
  const json muted = wish.value("muted", json());
  if (!key.is_string() || !muted.is_boolean())
    return InvalidArgument("layer is missing, or muted is neither true nor false");
  for (const auto& [id, heard] : bus_->State().layers) {
    if (KeyOf(id) != key.get<std::string>()) continue;
    ClientOptions client_options;
    client_options.channel_prefix = options_.watch.channel_prefix;
    client_options.robot = heard.value.daemon;
    client_options.keys = options_.watch.keys;
    SPLINEMAP_ASSIGN_OR_RETURN(const auto client,
                               MapClient::Connect(options_.lcm_url, client_options));
    const LayerCommand command = muted.get<bool>() ? LayerCommand::kMute : LayerCommand::kUnmute;
    const auto session = static_cast<uint64_t>(heard.value.status.session_number);
    return client->Set({command, id, session}, std::chrono::seconds(5));
  }
  for (const LayerSnapshot& layer : map_->Layers().layers) {
    if (KeyOf(layer.id) != key.get<std::string>()) continue;
    bus_->Call();
    return Unavailable("no daemon has said yet that it has the layer; try again in a second");
  }
  return NotFound("no daemon has the layer {}", key.get<std::string>());
}

}  // namespace splinemap
