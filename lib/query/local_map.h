#pragma once

#include <memory>

#include "lib/base/mutex.h"
#include "lib/map/map.h"
#include "lib/query/queryable_map.h"
#include "lib/query/surface_bounds.h"

namespace splinemap {

// What answers about this map call its revision: the commits to all of its layers.
uint64_t RevisionOf(const MapSnapshot& map);

// The map in this process. What queries need beside the map is made when one asks first, and then
// brought up to date with what changed. Thread-safe.
class LocalMap : public QueryableMap {
 public:
  explicit LocalMap(std::shared_ptr<const MapSnapshot> map) : map_(std::move(map)) {}

  // Later queries are about this map. Fast where it is a later snapshot of the same Map.
  void Show(std::shared_ptr<const MapSnapshot> map);
  std::shared_ptr<const MapSnapshot> Snapshot() const;
  // The present map for ever, with what was made for queries about it.
  std::shared_ptr<const LocalMap> Keep() const;

  absl::StatusOr<PointsQuery::Answer> Ask(const PointsQuery& query) const override;
  absl::StatusOr<RaysQuery::Answer> Ask(const RaysQuery& query) const override;
  absl::StatusOr<SweepsQuery::Answer> Ask(const SweepsQuery& query) const override;
  absl::StatusOr<RasterQuery::Answer> Ask(const RasterQuery& query) const override;
  absl::StatusOr<LikelihoodsQuery::Answer> Ask(const LikelihoodsQuery& query) const override;
  absl::StatusOr<DistancesQuery::Answer> Ask(const DistancesQuery& query) const override;

 private:
  struct BoundedMap {
    std::shared_ptr<const MapSnapshot> map;
    SurfaceBounds bounds;
  };
  BoundedMap Bounded() const;

  mutable Mutex mutex_;
  std::shared_ptr<const MapSnapshot> map_ ABSL_GUARDED_BY(mutex_);
  // One of its own, so that neither Show() nor other queries wait while bounds are made.
  mutable Mutex bounds_mutex_;
  mutable SurfaceBoundsEditor bounds_ ABSL_GUARDED_BY(bounds_mutex_);
  mutable BoundedMap bounded_ ABSL_GUARDED_BY(bounds_mutex_);  // of the last call of Bounded()
};

}  // namespace splinemap
