// Follows a map as a planner does, and prints how it is as a JSON line ten times a second. On
// SIGTERM it waits until it has caught up, for some seconds, saves the map and ends.
#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <chrono>
#include <csignal>
#include <cstdio>
#include <memory>
#include <string>
#include <thread>
#include <vector>

#include "lib/base/status.h"
#include "splinemap/file.h"
#include "splinemap/replica.h"

namespace splinemap {
namespace {

std::sig_atomic_t is_ended = 0;

bool IsWhole(const FollowedLayer& layer) { return layer.caught_up && layer.matches_digest; }

void Print(const FollowedLayer& layer, int64_t bytes_received) {
  const std::chrono::duration<double> now = std::chrono::system_clock::now().time_since_epoch();
  fmt::print(
      "{{\"time_s\": {:.3f}, \"session_number\": {}, \"revision\": {}, \"caught_up\": {}, "
      "\"tiles\": {}, \"bytes\": {}, \"folded\": {}, \"applied\": {}, \"stale\": {}, "
      "\"unusable\": {}, \"asked_scans\": {}, \"asked_tiles\": {}, \"asked_nodes\": {}}}\n",
      now.count(), layer.session.number, layer.revision, IsWhole(layer), layer.tiles,
      bytes_received, layer.counts.folded, layer.counts.applied, layer.counts.stale,
      layer.counts.unusable, layer.counts.asked_scans, layer.counts.asked_tiles,
      layer.counts.asked_nodes);
  std::fflush(stdout);
}

absl::Status Save(const LayerSet& set, const std::string& out) {
  SPLINEMAP_ASSIGN_OR_RETURN(MapFile file, MapFile::Open(out));
  SPLINEMAP_RETURN_IF_ERROR(file.Save(set).status());
  return file.Close();
}

// Of one robot.
absl::Status Run(const std::string& out, const FollowOptions& options) {
  SPLINEMAP_ASSIGN_OR_RETURN(const auto replica, MapReplica::Follow("", options));
  constexpr int kTicksToSync = 50;
  int ticks_left = kTicksToSync;
  bool caught_up = false;
  while (is_ended == 0 || (!caught_up && --ticks_left > 0)) {
    std::this_thread::sleep_for(std::chrono::milliseconds(100));
    const auto layers = replica->FollowedLayers();
    caught_up = !layers.empty() && IsWhole(layers.front());
    if (!layers.empty()) Print(layers.front(), replica->BytesReceived());
  }
  SPLINEMAP_RETURN_IF_ERROR(Save(replica->SyncedLayers(), out));
  return caught_up ? absl::OkStatus() : Unavailable("the map in {} is not whole", out);
}

int Main(int argc, char** argv) {
  CLI::App app("follower: follows the map of one robot on LCM_DEFAULT_URL");
  std::string out;
  app.add_option("OUT", out, "Map file to write at the end")->required();
  std::vector<double> region_m;
  app.add_option("--region", region_m, "x0 y0 x1 y1 in metres")->expected(4);
  FollowOptions options;
  app.add_flag("--tiles", options.takes_tiles, "Takes tiles, no scans");
  CLI11_PARSE(app, argc, argv);
  if (!region_m.empty())
    options.region = Region{region_m[0], region_m[1], region_m[2], region_m[3]};
  std::signal(SIGTERM, [](int) { is_ended = 1; });
  if (absl::Status status = Run(out, options); !status.ok()) {
    fmt::print(stderr, "follower: {}\n", ErrorText(status));
    return 1;
  }
  return 0;
}

}  // namespace
}  // namespace splinemap

int main(int argc, char** argv) { return splinemap::Main(argc, argv); }
