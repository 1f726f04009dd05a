#include <CLI/App.hpp>
#include <algorithm>
#include <chrono>
#include <cmath>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "clients/splinemap/bus_flags.h"
#include "clients/splinemap/commands.h"
#include "clients/splinemap/follow.h"
#include "clients/splinemap/print.h"
#include "lib/config/region_flag.h"
#include "lcmtypes/michigan/occupancy_grid_t.hpp"
#include "lib/base/mutex.h"
#include "lib/base/status.h"
#include "lib/render/map_parts.h"
#include "lib/render/pixel_grid.h"
#include "lib/wire/lcm_bus.h"
#include "splinemap/local_map.h"
#include "splinemap/region.h"
#include "splinemap/replica.h"

namespace splinemap {
namespace {

using std::chrono::milliseconds;

struct BridgeFlags {
  BusFlags bus;
  std::string channel = "SLAM_MAP";
  std::string region;
  FollowOptions follow;
  double rate_hz = 1;
  std::optional<double> resolution_m;
};

constexpr int kMaxSide = 2000;
constexpr double kMaxCells = double{kMaxSide} * kMaxSide;  // one byte each in a message
constexpr int kManyCells = 100'000;         // LCM begins to lose messages of this size
constexpr std::chrono::seconds kRepeat(5);  // for late subscribers
constexpr milliseconds kTick(10);

// Cells have the range of an int8 for -10 to 10 log-odds; one robot's map has -8 to 6. Only unknown
// cells are 0.
int8_t CellOf(int16_t units) {
  if (units == 0) return 0;
  constexpr double kCellsPerLogOdds = 12.7;
  const double cell = std::round(units * kCellsPerLogOdds / kUnitsPerLogOdds);
  return static_cast<int8_t>(units < 0 ? std::clamp(cell, -127.0, -1.0)
                                       : std::clamp(cell, 1.0, 127.0));
}

// Each cell is the greatest of `samples` x `samples` points of the surface, no further apart than
// its control points, so that coarse cells keep thin walls.
struct CellGrid {
  int samples = 1;
  int width = 0;
  int height = 0;
  double cell_m = 0;
  Eigen::Vector2d first_sample_m;  // the lower left one of the lower left cell

  double sample_m() const { return cell_m / samples; }
};

absl::StatusOr<CellGrid> GridOf(const MapView& map, const std::optional<Region>& region,
                                double cell_m) {
  CellGrid grid;
  grid.cell_m = cell_m;
  grid.samples = static_cast<int>(std::ceil(cell_m / map.options.knot_interval_m - 1e-6));
  SPLINEMAP_ASSIGN_OR_RETURN(const PixelGrid pixels, GridOfRegion(map, region, grid.sample_m()));
  // Cells begin at multiples of their size, so that they stay where they are when the map grows.
  const auto cell = [&](double sample_m) {
    return static_cast<int>(std::floor(std::round(sample_m / grid.sample_m()) / grid.samples));
  };
  const int left = cell(pixels.CentreX(0));
  const int bottom = cell(pixels.CentreY(pixels.height - 1));
  grid.width = cell(pixels.CentreX(pixels.width - 1)) - left + 1;
  grid.height = cell(pixels.CentreY(0)) - bottom + 1;
  grid.first_sample_m = cell_m * Eigen::Vector2d(left, bottom);
  const double cells = double{1} * grid.width * grid.height;
  if (cells > kMaxCells) {
    return FailedPrecondition(
        "a message of {} x {} cells is too large for LCM, which takes {:g}; make --region smaller, "
        "or --resolution greater than {} m",
        grid.width, grid.height, kMaxCells, cell_m);
  }
  return grid;
}

absl::StatusOr<michigan::occupancy_grid_t> GridMessage(const QueryableMap& map,
                                                       const CellGrid& grid) {
  RasterQuery query;
  query.first_m = grid.first_sample_m;
  query.resolution_m = grid.sample_m();
  query.width = grid.width * grid.samples;
  query.height = grid.height * grid.samples;
  SPLINEMAP_ASSIGN_OR_RETURN(const RasterQuery::Answer raster, map.Ask(query));

  std::vector<int16_t> greatest(size_t{1} * grid.width * grid.height);
  for (int row = 0; row < query.height; ++row) {
    for (int column = 0; column < query.width; ++column) {
      const int16_t sample = raster.cells[size_t{1} * row * query.width + column];
      int16_t& cell =
          greatest[size_t{1} * (row / grid.samples) * grid.width + column / grid.samples];
      if (sample != 0 && (cell == 0 || sample > cell)) cell = sample;
    }
  }
  michigan::occupancy_grid_t message;
  message.utime = std::chrono::duration_cast<std::chrono::microseconds>(
                      std::chrono::system_clock::now().time_since_epoch())
                      .count();
  const Eigen::Vector2d origin_m =
      grid.first_sample_m - Eigen::Vector2d::Constant(grid.sample_m() / 2);
  message.origin_x = static_cast<float>(origin_m.x());
  message.origin_y = static_cast<float>(origin_m.y());
  message.meters_per_cell = static_cast<float>(grid.cell_m);
  message.width = grid.width;
  message.height = grid.height;
  message.num_cells = grid.width * grid.height;
  std::transform(greatest.begin(), greatest.end(), std::back_inserter(message.cells), CellOf);
  return message;
}

// The part of the map to publish. Thread-safe.
class PublishedPart {
 public:
  void HasChanged(const Region& region) {
    MutexLock lock(mutex_);
    newest_change_ = region;
    is_changed_ = true;
  }
  // Since the last call.
  bool TakeChange() {
    MutexLock lock(mutex_);
    return std::exchange(is_changed_, false);
  }

  // Nothing where a message has room for all cells; else what the map has in a square of as many as
  // it takes. The square stays until a change lies out of it, and begins with the largest part.
  std::optional<Region> Of(const MapView& map, double cell_m) {
    MutexLock lock(mutex_);
    const double knot_m = map.options.knot_interval_m;
    const std::vector<MapPart> parts = PartsOf(map);
    const Region whole = RegionOf(BoxOf(parts), knot_m);
    if ((whole.x1_m - whole.x0_m) * (whole.y1_m - whole.y0_m) <= kMaxCells * cell_m * cell_m) {
      square_.reset();
      return std::nullopt;
    }
    const double side_m = (kMaxSide - 2) * cell_m;
    const double change_m = std::max(newest_change_.x1_m - newest_change_.x0_m,
                                     newest_change_.y1_m - newest_change_.y0_m);
    if (change_m < side_m && !(square_ && Contains(*square_, newest_change_))) {
      square_ = SquareAround(newest_change_, side_m);
    }
    std::optional<Region> mapped = square_ ? MappedIn(*square_, map) : std::nullopt;
    if (!mapped) {
      square_ = SquareAround(RegionOf(parts[0].box, knot_m), side_m);
      mapped = MappedIn(*square_, map);
    }
    return mapped;
  }

 private:
  static Region SquareAround(const Region& region, double side_m) {
    const double x_m = (region.x0_m + region.x1_m) / 2;
    const double y_m = (region.y0_m + region.y1_m) / 2;
    return {x_m - side_m / 2, y_m - side_m / 2, x_m + side_m / 2, y_m + side_m / 2};
  }
  static std::optional<Region> MappedIn(const Region& square, const MapView& map) {
    const double knot_m = map.options.knot_interval_m;
    const TileBox in_square = TilesOf(square, knot_m);
    TileBox box;
    map.tiles.ForEach([&](TileKey key, const TileTree::Entry&) {
      if (in_square.Contains(key)) box.Add(key);
    });
    if (box.IsEmpty()) return std::nullopt;
    const Region mapped = RegionOf(box, knot_m);
    return Region{std::max(mapped.x0_m, square.x0_m), std::max(mapped.y0_m, square.y0_m),
                  std::min(mapped.x1_m, square.x1_m), std::min(mapped.y1_m, square.y1_m)};
  }
  static bool Contains(const Region& region, const Region& other) {
    return region.x0_m <= other.x0_m && other.x1_m <= region.x1_m && region.y0_m <= other.y0_m &&
           other.y1_m <= region.y1_m;
  }

  Mutex mutex_;
  Region newest_change_ ABSL_GUARDED_BY(mutex_);
  bool is_changed_ ABSL_GUARDED_BY(mutex_) = false;
  std::optional<Region> square_ ABSL_GUARDED_BY(mutex_);
};

// Says once what people may not expect of the messages.
class BridgeNotes {
 public:
  void Note(const std::string& channel, const CellGrid& grid, bool is_part) {
    if (!std::exchange(has_begun_, true)) {
      PrintLine(stderr, "{}: {} x {} cells of {} m", channel, grid.width, grid.height, grid.cell_m);
    }
    if (is_part && !std::exchange(has_noted_part_, true)) {
      PrintLine(stderr,
                "{}: the map has more cells than the {:g} that a message takes; what lies within "
                "{:g} m of the newest change is published. --region chooses another part, "
                "--resolution makes the cells larger",
                channel, kMaxCells, kMaxSide / 2 * grid.cell_m);
    }
    const int cells = grid.width * grid.height;
    if (cells > kManyCells && !std::exchange(has_noted_size_, true)) {
      PrintLine(
          stderr,
          "{}: LCM over UDP loses some messages of {} kB; recv_buf_size= in the URL of receivers "
          "makes that rarer, --resolution and --region make the messages smaller",
          channel, cells / 1000);
    }
  }

 private:
  bool has_begun_ = false;
  bool has_noted_part_ = false;
  bool has_noted_size_ = false;
};

// Runs until a signal ends it, or --region is too large.
absl::StatusOr<int> BridgeOccupancyGrid(BridgeFlags flags) {
  SPLINEMAP_ASSIGN_OR_RETURN(flags.follow.region, ParseRegion(flags.region));
  SPLINEMAP_ASSIGN_OR_RETURN(const std::unique_ptr<LcmBus> bus, LcmBus::Open(flags.bus.lcm_url));
  flags.follow.channel_prefix = flags.bus.channel_prefix;
  SPLINEMAP_ASSIGN_OR_RETURN(flags.follow.keys, flags.bus.Keys());
  PublishedPart part;
  SPLINEMAP_ASSIGN_OR_RETURN(
      const auto replica,
      MapReplica::Follow(flags.bus.lcm_url, flags.follow,
                         [&](const MapView&, const Region& changed) { part.HasChanged(changed); }));
  const auto interval = std::chrono::duration<double>(1 / flags.rate_hz);
  std::optional<Clock::time_point> last_publish;
  BridgeNotes notes;
  while (true) {
    bus->Handle(kTick);
    if (const auto news = bus->DrainNews()) PrintLine(stderr, "{}", *news);
    const Clock::time_point now = Clock::now();
    if (last_publish && now - *last_publish < interval) continue;
    const bool repeats = last_publish && now - *last_publish >= kRepeat;
    if (!part.TakeChange() && !repeats) continue;
    const std::shared_ptr<const MapView> map = replica->View();
    if (map->tiles.size() == 0) continue;  // its layers were removed, say
    const double cell_m = flags.resolution_m.value_or(map->options.knot_interval_m);
    const std::optional<Region> region =
        flags.follow.region ? flags.follow.region : part.Of(*map, cell_m);
    SPLINEMAP_ASSIGN_OR_RETURN(const CellGrid grid, GridOf(*map, region, cell_m));
    SPLINEMAP_ASSIGN_OR_RETURN(const auto message, GridMessage(LocalMap(map), grid));
    bus->Publish(flags.channel, message);
    notes.Note(flags.channel, grid, region && !flags.follow.region);
    last_publish = now;
  }
}

constexpr const char* kBridgeExamples = R"(
Examples:
  splinemap bridge occupancy-grid
  splinemap bridge occupancy-grid --resolution 0.1 --region -5,-5,20,10
  splinemap bridge occupancy-grid --robot one --channel ONE_MAP --rate-hz 0.2

Follows the daemons on a bus and publishes their map as Michigan's occupancy_grid_t after each
change, at most --rate-hz times a second, and every 5 s. A cell is 12.7 times the log-odds, within
-127 .. 127: positive is occupied, negative free, 0 unknown. Known cells that would round to 0 are 1
or -1. A cell larger than the knot interval has the greatest log-odds
within, so that thin walls stay. The origin is the lower left corner of the first cell; utime is the
time of publication. Of a map of more than 4 million cells it publishes what lies in 2000 x 2000
around the newest change.)";

}  // namespace

void AddBridge(CLI::App& app, Command& chosen) {
  auto flags = std::make_shared<BridgeFlags>();
  CLI::App* bridge =
      app.add_subcommand("bridge", "Publish the map on an LCM bus in the types of other stacks");
  bridge->require_subcommand(1);
  bridge->footer(
      "\nExample:\n  splinemap bridge occupancy-grid\n\n"
      "splinemap bridge occupancy-grid --help explains it.");
  CLI::App* command = bridge->add_subcommand(
      "occupancy-grid", "Publish Michigan's occupancy_grid_t, for botlab and mbot");
  command->footer(kBridgeExamples);
  AddBusFlags(*command, flags->bus);
  AddRobotsFlag(*command, flags->follow.names);
  AddRegionFlag(*command, flags->region);
  command->add_option("--channel", flags->channel, "Channel to publish on (default SLAM_MAP)");
  command->add_option("--rate-hz", flags->rate_hz, "Greatest rate of messages (default 1)")
      ->check(CLI::Range(0.01, 100.0));
  command
      ->add_option("--resolution", flags->resolution_m,
                   "m, side of a cell (default: the knot interval)")
      ->check(CLI::Range(0.001, 100.0));
  command->callback([flags, &chosen] { chosen = [flags] { return BridgeOccupancyGrid(*flags); }; });
}

}  // namespace splinemap
