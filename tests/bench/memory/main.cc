// Maps that are larger than memory: how soon a daemon answers, what it takes, how soon it ends, and
// what a query costs whose tiles are in the file.
#include <fmt/format.h>
#include <signal.h>
#include <sys/wait.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <filesystem>
#include <fstream>
#include <random>
#include <string>
#include <thread>

#include "lib/base/clock.h"
#include "lib/base/status.h"
#include "lib/tiles/tile_memory.h"
#include "splinemap/client.h"
#include "splinemap/file.h"
#include "splinemap/local_map.h"
#include "tests/support/child_process.h"
#include "tests/support/temporary_directory.h"

namespace splinemap::bench {
namespace {

using Seconds = std::chrono::duration<double>;

double SecondsSince(Clock::time_point begin) { return Seconds(Clock::now() - begin).count(); }

// A wall and free space on both sides, which compresses as tiles of real maps do.
Tile RandomTile(std::mt19937_64& random) {
  Tile tile;
  const int wall = static_cast<int>(random() % Tile::kSide);
  for (int k = 0; k < Tile::kSize; ++k) {
    const int away = std::abs(k % Tile::kSide - wall);
    const int noise = static_cast<int>(random() % 32);
    tile.control_points[k] = static_cast<ControlPoint>(
        (away < 3 ? 1500 - 500 * away : std::max(-2000, -300 * away)) + noise);
  }
  return tile;
}

LayerSet MapOf(size_t num_tiles) {
  std::mt19937_64 random(1);
  std::vector<Tile> kinds;
  for (int k = 0; k < 1000; ++k) kinds.push_back(RandomTile(random));
  TileTreeEditor tiles;
  const auto side = static_cast<int32_t>(std::ceil(std::sqrt(num_tiles)));
  for (size_t n = 0; n < num_tiles; ++n) {
    const TileKey key{static_cast<int32_t>(n) % side - side / 2,
                      static_cast<int32_t>(n) / side - side / 2};
    tiles.Put(key, std::make_shared<const StoredTile>(kinds[random() % kinds.size()]), 1);
  }
  MapOptions options;
  options.limits = {-64 * kUnitsPerLogOdds, 64 * kUnitsPerLogOdds};
  LayerSet set{.options = options};
  LayerSnapshot& layer = set.layers.emplace_back();
  layer.id = {"robot", 1};
  layer.session = {1, 1};
  layer.revision = 1;
  layer.tiles = tiles.Freeze();
  set.own_layer = layer.id;
  return set;
}

// In MB, of a line of /proc/PID/status.
double MemoryMb(const std::string& pid, const std::string& what) {
  std::ifstream file("/proc/" + pid + "/status");
  for (std::string line; std::getline(file, line);) {
    if (line.starts_with(what + ":")) return std::stod(line.substr(what.size() + 1)) / 1024;
  }
  return 0;
}

struct Figures {
  double first_answer_s = 0;
  double after_start_mb = 0;
  double after_queries_mb = 0;
  double peak_mb = 0;
  double end_s = 0;
};

PointsQuery RandomPoints(std::mt19937_64& random, double half_side_m, int count) {
  std::uniform_real_distribution<double> place_m(-half_side_m, half_side_m);
  PointsQuery query;
  for (int n = 0; n < count; ++n) query.points_m.push_back({place_m(random), place_m(random)});
  return query;
}

absl::StatusOr<Figures> RunDaemon(const std::string& path, size_t num_tiles, int budget_mb,
                                  int queries) {
  const TemporaryDirectory folder;
  std::ofstream(folder.File("config"))
      << fmt::format("service {{ max_memory_mb: {} sensors: false }} name: 'robot'\n", budget_mb);
  Figures figures;
  const Clock::time_point begin = Clock::now();
  ChildProcess daemon({SPLINEMAPD_PROGRAM, "--config", folder.File("config"), "--map", path});
  ClientOptions options;
  options.robot = "robot";
  options.deadline = std::chrono::minutes(2);
  SPLINEMAP_ASSIGN_OR_RETURN(const auto client, MapClient::Connect("", options));
  std::mt19937_64 random(2);
  const double half_side_m = 0.8 * std::sqrt(static_cast<double>(num_tiles));
  SPLINEMAP_RETURN_IF_ERROR(client->Ask(RandomPoints(random, half_side_m, 1)).status());
  figures.first_answer_s = SecondsSince(begin);
  std::this_thread::sleep_for(std::chrono::seconds(3));
  const std::string pid = std::to_string(daemon.pid());
  figures.after_start_mb = MemoryMb(pid, "VmRSS");
  for (int n = 0; n < queries; ++n) {
    SPLINEMAP_RETURN_IF_ERROR(client->Ask(RandomPoints(random, half_side_m, 1000)).status());
  }
  figures.after_queries_mb = MemoryMb(pid, "VmRSS");
  figures.peak_mb = MemoryMb(pid, "VmHWM");
  const Clock::time_point stop = Clock::now();
  kill(daemon.pid(), SIGINT);
  siginfo_t ended{};
  waitid(P_PID, static_cast<id_t>(daemon.pid()), &ended, WEXITED | WNOWAIT);
  figures.end_s = SecondsSince(stop);
  return figures;
}

// The median and the 99th percentile of the time of a query of one point, in microseconds, with so
// many of the tiles in memory.
absl::Status PrintQueries(const std::string& path, size_t num_tiles, double share, int queries) {
  const auto memory =
      std::make_shared<TileMemory>(static_cast<size_t>(share * static_cast<double>(num_tiles)));
  SPLINEMAP_ASSIGN_OR_RETURN(MapFile file, MapFile::Open(path, memory));
  SPLINEMAP_ASSIGN_OR_RETURN(const LoadedMap loaded, file.Load());
  const LocalMap map(ViewOf(loaded.set));
  std::mt19937_64 random(3);
  const double half_side_m = 0.8 * std::sqrt(static_cast<double>(num_tiles));
  std::vector<double> times_us;
  for (int n = 0; n < 2 * queries; ++n) {
    const PointsQuery query = RandomPoints(random, half_side_m, 1);
    const Clock::time_point begin = Clock::now();
    SPLINEMAP_RETURN_IF_ERROR(map.Ask(query).status());
    if (n >= queries) times_us.push_back(1e6 * SecondsSince(begin));
  }
  std::sort(times_us.begin(), times_us.end());
  fmt::print("{:>10} tiles, {:>5.0f} % in memory: {:>8.2f} us median, {:>8.2f} us 99 %\n",
             num_tiles, 100 * share, times_us[times_us.size() / 2],
             times_us[times_us.size() * 99 / 100]);
  return absl::OkStatus();
}

absl::Status Run(const std::vector<size_t>& sizes, int budget_mb, int queries) {
  fmt::print("budget {} MB\n{:>10} {:>9} {:>10} {:>11} {:>11} {:>9} {:>8} {:>8}\n", budget_mb,
             "tiles", "file MB", "answers s", "start MB", "queries MB", "peak MB", "end s",
             "write s");
  const TemporaryDirectory folder;
  for (const size_t num_tiles : sizes) {
    const std::string path = folder.File(std::to_string(num_tiles));
    const Clock::time_point begin = Clock::now();
    {
      SPLINEMAP_ASSIGN_OR_RETURN(MapFile file, MapFile::Open(path));
      SPLINEMAP_RETURN_IF_ERROR(file.Save(MapOf(num_tiles)).status());
      SPLINEMAP_RETURN_IF_ERROR(file.Close());
    }
    const double write_s = SecondsSince(begin);
    SPLINEMAP_ASSIGN_OR_RETURN(const Figures figures,
                               RunDaemon(path, num_tiles, budget_mb, queries));
    fmt::print("{:>10} {:>9.1f} {:>10.2f} {:>11.0f} {:>11.0f} {:>9.0f} {:>8.2f} {:>8.1f}\n",
               num_tiles, static_cast<double>(std::filesystem::file_size(path)) / (1 << 20),
               figures.first_answer_s, figures.after_start_mb, figures.after_queries_mb,
               figures.peak_mb, figures.end_s, write_s);
    std::fflush(stdout);
    for (const double share : {1.0, 0.5, 0.01}) {
      SPLINEMAP_RETURN_IF_ERROR(PrintQueries(path, num_tiles, share, 100 * queries));
    }
    std::filesystem::remove(path);
  }
  return absl::OkStatus();
}

int Main(int argc, char** argv) {
  CLI::App app("memory_bench: maps larger than memory; run it by deploy/own_bus.sh");
  std::vector<size_t> sizes{10'000, 100'000, 1'000'000};
  int budget_mb = 256;
  int queries = 300;
  app.add_option("--tiles", sizes, "Sizes of maps");
  app.add_option("--budget-mb", budget_mb, "max_memory_mb of the daemon");
  app.add_option("--queries", queries, "Queries of 1,000 points to each daemon");
  CLI11_PARSE(app, argc, argv);
  if (const absl::Status status = Run(sizes, budget_mb, queries); !status.ok()) {
    fmt::print(stderr, "memory_bench: {}\n", ErrorText(status));
    return 1;
  }
  return 0;
}

}  // namespace
}  // namespace splinemap::bench

int main(int argc, char** argv) { return splinemap::bench::Main(argc, argv); }
