// Follows the map on a bus until a robot has mapped something, prints it and keeps it in a file.
// usage: follow FILE
#include <splinemap/file.h>
#include <splinemap/replica.h>

#include <chrono>
#include <cstdio>
#include <thread>

namespace {

bool IsComplete(const splinemap::MapReplica& replica) {
  for (const splinemap::FollowedLayer& layer : replica.FollowedLayers()) {
    if (layer.caught_up && layer.tiles > 0) return true;
  }
  return false;
}

}  // namespace

int main(int argc, char** argv) {
  if (argc != 2) return 2;
  auto replica = splinemap::MapReplica::Follow("", {});
  if (!replica.ok()) {
    std::fprintf(stderr, "%s\n", std::string(replica.status().message()).c_str());
    return 1;
  }
  const auto deadline = std::chrono::steady_clock::now() + std::chrono::seconds(20);
  while (!IsComplete(**replica)) {
    if (std::chrono::steady_clock::now() > deadline) {
      std::fprintf(stderr, "no map within 20 s\n");
      return 1;
    }
    std::this_thread::sleep_for(std::chrono::milliseconds(20));
  }

  const auto view = (*replica)->View();
  const splinemap::SurfaceSample origin = view->Evaluate(0, 0);
  std::printf("%zu tiles; at the origin %s, log-odds %.2f\n", view->tiles.size(),
              origin.known ? "known" : "not known", origin.log_odds);

  auto file = splinemap::MapFile::Open(argv[1]);
  if (!file.ok()) return 1;
  return file->Save((*replica)->SyncedLayers()).ok() && file->Close().ok() ? 0 : 1;
}
