#pragma once

#include <atomic>
#include <boost/asio/awaitable.hpp>
#include <boost/asio/io_context.hpp>
#include <boost/asio/steady_timer.hpp>
#include <map>
#include <memory>
#include <optional>
#include <set>
#include <string>

#include "absl/status/statusor.h"
#include "lib/map/summed_layers.h"
#include "services/viewer/browser_view.h"
#include "services/viewer/bus_watch.h"
#include "services/viewer/http_api.h"
#include "services/viewer/metrics.h"
#include "services/viewer/sections.h"
#include "services/viewer/shown_map.h"
#include "services/viewer/state_json.h"
#include "services/viewer/sum_levels.h"
#include "services/viewer/surface_levels.h"
#include "services/viewer/tile_bodies.h"

namespace splinemap {

struct ViewerOptions {
  std::string map;     // a file; empty: the bus, or the fleet
  FleetAddress fleet;  // without servers: the bus
  std::string lcm_url;
  WatchOptions watch;
  std::string goal_channel = "GOAL";
  bool allows_commands = false;
};

// What all browsers are shown. One thread, that of the io_context, but for what is said.
class Viewer {
 public:
  static constexpr size_t kMaxBrowsers = 64;

  // A page that is open.
  struct Browser {
    explicit Browser(boost::asio::io_context& io) : wake(io) {}

    BrowserView view;
    boost::asio::steady_timer wake;  // cancelled when there may be news
    bool is_gone = false;
  };

  // Errors: those of the bus or the file. `io` outlives it.
  static absl::StatusOr<std::unique_ptr<Viewer>> Open(boost::asio::io_context& io,
                                                      const ViewerOptions& options);
  ~Viewer();

  // Null where there are kMaxBrowsers.
  std::shared_ptr<Browser> Join();
  void Leave(const std::shared_ptr<Browser>& browser);
  // As BrowserView::Handle().
  absl::Status Handle(Browser& browser, std::string_view message);
  std::optional<std::string> NextFrame(Browser& browser);

  // Any thread. Both may take as long as a query, or a daemon's answer.
  HttpAnswer Get(const HttpTarget& target) const;
  HttpAnswer Post(const HttpTarget& target, const std::string& body);

  Metrics& metrics() { return metrics_; }

 private:
  Viewer(boost::asio::io_context& io, const ViewerOptions& options);

  void Nudge();  // any thread
  boost::asio::awaitable<void> KeepUpToDate();
  bool Refresh();
  bool AdvanceSurfaces(const LayerSet& set, const MapView& view);
  void SetSections(const MapView& view);
  absl::Status Execute(const HttpTarget& target, const std::string& body);
  absl::Status SendGoal(const std::string& body);
  absl::Status Mute(const std::string& body);

  boost::asio::io_context& io_;
  const ViewerOptions options_;
  MapFacts facts_;
  std::unique_ptr<ShownMap> map_;
  std::unique_ptr<BusWatch> bus_;  // null for a file or a fleet
  SumLevels sum_levels_;
  std::unique_ptr<HttpApi> api_;
  Metrics metrics_;
  std::map<std::string, SurfaceLevels> surfaces_;  // that somebody looks at, and "sum"
  std::map<std::string, SummedLayers> placed_;     // each of these layers alone, in its place
  TileBodies bodies_;
  Sections sections_;
  double knot_interval_m_ = MapOptions().knot_interval_m;
  std::set<std::shared_ptr<Browser>> browsers_;
  Clock::time_point watched_since_;  // by some browser
  boost::asio::steady_timer news_;
  std::atomic<bool> is_nudged_ = true;
};

}  // namespace splinemap
