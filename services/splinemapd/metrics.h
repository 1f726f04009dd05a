#pragma once

#include <prometheus/collectable.h>
#include <prometheus/metric_family.h>

#include <memory>
#include <vector>

#include "absl/status/statusor.h"
#include "services/splinemapd/daemon.h"

namespace prometheus {
class Exposer;
}

namespace splinemap {

// What a daemon published last as metrics of Prometheus: services/splinemapd/README.md lists them.
// Names of layers, which come from the bus, are plain text.
std::vector<prometheus::MetricFamily> MetricsOf(const Daemon::Published& published);

// Serves the metrics of a daemon at http://127.0.0.1:PORT/metrics, made when they are asked for.
class MetricsServer {
 public:
  // `daemon` outlives it. Unavailable where the port cannot be listened on.
  static absl::StatusOr<std::unique_ptr<MetricsServer>> Listen(uint32_t port, const Daemon& daemon);
  ~MetricsServer();

 private:
  MetricsServer() = default;

  std::shared_ptr<prometheus::Collectable> metrics_;
  std::unique_ptr<prometheus::Exposer> exposer_;  // ends before what it collects
};

}  // namespace splinemap
