#pragma once

#include <memory>

#include "lib/base/mutex.h"
#include "lib/map/map_view.h"
#include "lib/query/queryable_map.h"
#include "lib/query/surface_bounds.h"

namespace splinemap {

// The map in this process. What queries need beside the map is made when one asks first, and then
// brought up to date with what changed. Thread-safe.
class LocalMap : public QueryableMap {
 public:
  explicit LocalMap(std::shared_ptr<const MapView> map) : map_(std::move(map)) {}

  // Later queries are about this map. Fast where it is a later view by the same SummedLayers.
  void Use(std::shared_ptr<const MapView> map);
  std::shared_ptr<const MapView> View() const;
  // The present map for ever, with what was made for queries about it.
  std::shared_ptr<const LocalMap> Keep() const;

  absl::StatusOr<AnyAnswer> AskAny(const AnyQuery& query) const override;

 private:
  struct BoundedMap {
    std::shared_ptr<const MapView> map;
    SurfaceBounds bounds;
  };
  absl::StatusOr<PointsQuery::Answer> Answer(const PointsQuery& query) const;
  absl::StatusOr<RaysQuery::Answer> Answer(const RaysQuery& query) const;
  absl::StatusOr<SweepsQuery::Answer> Answer(const SweepsQuery& query) const;
  absl::StatusOr<RasterQuery::Answer> Answer(const RasterQuery& query) const;
  absl::StatusOr<LikelihoodsQuery::Answer> Answer(const LikelihoodsQuery& query) const;
  absl::StatusOr<DistancesQuery::Answer> Answer(const DistancesQuery& query) const;
  BoundedMap Bounded() const;

  mutable Mutex mutex_;
  std::shared_ptr<const MapView> map_ ABSL_GUARDED_BY(mutex_);
  // One of its own, so that neither Use() nor other queries wait while bounds are made.
  mutable Mutex bounds_mutex_;
  mutable SurfaceBoundsEditor bounds_ ABSL_GUARDED_BY(bounds_mutex_);
  mutable BoundedMap bounded_ ABSL_GUARDED_BY(bounds_mutex_);  // of the last call of Bounded()
};

}  // namespace splinemap
