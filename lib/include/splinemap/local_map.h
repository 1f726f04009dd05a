#pragma once

#include <memory>

#include "splinemap/map_view.h"
#include "splinemap/queryable_map.h"

namespace splinemap {

// The map in this process. What queries need beside the map is made when one asks first, and then
// brought up to date with what changed. Thread-safe.
class LocalMap : public QueryableMap {
 public:
  explicit LocalMap(std::shared_ptr<const MapView> map);
  ~LocalMap() override;

  // Later queries are about this map. Fast where it is a later view by the same SummedLayers.
  void Use(std::shared_ptr<const MapView> map);
  std::shared_ptr<const MapView> View() const;
  // The present map for ever, with what was made for queries about it.
  std::shared_ptr<const LocalMap> Keep() const;

  absl::StatusOr<AnyAnswer> AskAny(const AnyQuery& query) const override;

 private:
  class Impl;
  const std::unique_ptr<Impl> impl_;
};

}  // namespace splinemap
