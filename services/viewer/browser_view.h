#pragma once

#include <cstdint>
#include <functional>
#include <optional>
#include <string>
#include <string_view>
#include <tuple>
#include <vector>

#include "absl/container/flat_hash_map.h"
#include "absl/status/status.h"
#include "services/viewer/sections.h"
#include "services/viewer/surface_levels.h"
#include "services/viewer/tile_bodies.h"
#include "splinemap/region.h"
#include "splinemap/utime.h"

namespace splinemap {

// What one page wants to see.
struct ViewRequest {
  static constexpr int64_t kMaxTiles = 4096;  // of a surface
  static constexpr size_t kMaxSurfaces = 32;

  Region region;
  int level = 0;
  std::vector<std::string> surfaces;  // "sum", or keys of layers
};

// The time whose map a page wants to see.
struct TimeRequest {
  std::optional<Utime> utime;  // none: now
};

// Surfaces by their names in requests; null where there is none.
using FindSurface = std::function<const SurfaceLevels*(const std::string& name)>;

// What one browser was sent and has taken in. It gets a frame only after the last one was
// acknowledged, so a slow one gets fewer. Thread-compatible.
class BrowserView {
 public:
  static constexpr size_t kMaxFrameBytes = 256 << 10;  // of tiles

  // Takes what the page says. InvalidArgument for what is no message of the page.
  absl::Status Handle(std::string_view message);

  const std::optional<ViewRequest>& request() const { return request_; }
  // Where the last message has one.
  const std::optional<TimeRequest>& time_request() const { return time_request_; }

  // The next frame, or none while the last is not acknowledged or nothing is new. README.md has
  // the format.
  std::optional<std::string> NextFrame(const Sections& sections, double knot_interval_m,
                                       const FindSurface& find, TileBodies& bodies);

 private:
  using SentKey = std::tuple<int, TileKey>;  // surface, tile
  struct Wanted {
    int surface;
    TileKey key;
    const SurfaceLevels::Change* change;
    double distance;
  };

  absl::Status SetRequest(ViewRequest request);
  std::vector<Wanted> FindWanted(double knot_interval_m, const FindSurface& find);

  std::optional<ViewRequest> request_;
  std::optional<TimeRequest> time_request_;
  bool is_request_new_ = false;
  bool is_complete_ = true;
  absl::flat_hash_map<SentKey, uint64_t> sent_;  // numbers of changes, of the present request
  // By surface: it was looked through for changes up to that number.
  std::vector<uint64_t> sent_up_to_;
  Sections::Numbers sent_sections_{};
  int64_t frame_ = 0;
  int64_t acknowledged_ = 0;
};

}  // namespace splinemap
