#include "services/viewer/metrics.h"

#include <prometheus/text_serializer.h>

namespace splinemap {
namespace {

prometheus::Gauge& AddGauge(prometheus::Registry& registry, const char* name, const char* help) {
  return prometheus::BuildGauge().Name(name).Help(help).Register(registry).Add({});
}

prometheus::Counter& AddCounter(prometheus::Registry& registry, const char* name,
                                const char* help) {
  return prometheus::BuildCounter().Name(name).Help(help).Register(registry).Add({});
}

}  // namespace

Metrics::Metrics()
    : browsers(AddGauge(registry_, "splinemap_viewer_browsers", "Pages that are open")),
      connections(AddGauge(registry_, "splinemap_viewer_connections", "Connections that are open")),
      tiles(AddGauge(registry_, "splinemap_viewer_tiles", "Tiles of the sum of the layers")),
      revision(AddGauge(registry_, "splinemap_viewer_revision", "Commits to all layers")),
      bytes_from_bus(AddGauge(registry_, "splinemap_viewer_bus_bytes",
                              "Bytes that the replica received from the bus")),
      frames(AddCounter(registry_, "splinemap_viewer_frames_total", "Frames sent to pages")),
      frame_bytes(
          AddCounter(registry_, "splinemap_viewer_frame_bytes_total", "Bytes of those frames")),
      requests(AddCounter(registry_, "splinemap_viewer_requests_total", "HTTP requests")),
      refused(AddCounter(registry_, "splinemap_viewer_refused_total",
                         "Connections and requests that were refused")) {}

std::string Metrics::Text() const {
  return prometheus::TextSerializer().Serialize(registry_.Collect());
}

}  // namespace splinemap
