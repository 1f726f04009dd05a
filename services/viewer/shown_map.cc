#include "services/viewer/shown_map.h"

#include <utility>

#include "absl/strings/str_join.h"
#include "lib/base/status.h"
#include "splinemap/file.h"
#include "splinemap/local_map.h"
#include "splinemap/replica.h"

namespace splinemap {
namespace {

class MapOnBus : public ShownMap {
 public:
  explicit MapOnBus(std::unique_ptr<MapReplica> replica) : replica_(std::move(replica)) {}

  LayerSet Layers() const override { return replica_->Layers(); }
  std::shared_ptr<const MapView> View() const override { return replica_->View(); }
  const QueryableMap& map() const override { return *replica_; }
  std::vector<FollowedLayer> FollowedLayers() const override { return replica_->FollowedLayers(); }
  bool IsCaughtUp() const override { return replica_->IsCaughtUp(); }
  std::vector<std::string> Refused() const override { return replica_->Refused(); }
  std::string BusProblem() const override { return replica_->BusProblem(); }
  int64_t BytesReceived() const override { return replica_->BytesReceived(); }

 private:
  const std::unique_ptr<MapReplica> replica_;
};

class MapInFile : public ShownMap {
 public:
  explicit MapInFile(LayerSet set) : set_(std::move(set)), map_(ViewOf(set_)) {}

  LayerSet Layers() const override { return set_; }
  std::shared_ptr<const MapView> View() const override { return map_.View(); }
  const QueryableMap& map() const override { return map_; }

 private:
  const LayerSet set_;
  const LocalMap map_;
};

}  // namespace

absl::StatusOr<std::unique_ptr<ShownMap>> FollowMap(const std::string& lcm_url,
                                                    const FollowOptions& options,
                                                    std::function<void()> on_change) {
  SPLINEMAP_ASSIGN_OR_RETURN(
      auto replica, MapReplica::Follow(lcm_url, options,
                                       [on_change = std::move(on_change)](
                                           const MapView&, const Region&) { on_change(); }));
  return std::make_unique<MapOnBus>(std::move(replica));
}

absl::StatusOr<std::unique_ptr<ShownMap>> OpenMap(const std::string& path) {
  SPLINEMAP_ASSIGN_OR_RETURN(LoadedMap loaded, ReadMapFile(path));
  if (!loaded.corruption.empty()) {
    return DataLoss("{} is damaged; `splinemap merge --accept-corrupt` saves what can be read: {}",
                    path, absl::StrJoin(loaded.corruption, "; "));
  }
  return std::make_unique<MapInFile>(std::move(loaded.set));
}

}  // namespace splinemap
