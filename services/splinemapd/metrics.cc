#include "services/splinemapd/metrics.h"

#include <fmt/format.h>
#include <prometheus/exposer.h>

#include <exception>
#include <map>
#include <string>
#include <utility>

#include "lib/base/plain_text.h"
#include "lib/base/status.h"
#include "lib/sensing/drop_counts.h"

namespace splinemap {
namespace {

using prometheus::ClientMetric;
using prometheus::MetricFamily;
using prometheus::MetricType;
using Labels = std::vector<ClientMetric::Label>;

// Adds values to families, which stand in the order in which they were begun.
class Families {
 public:
  void Count(const std::string& name, const std::string& help, int64_t value, Labels labels = {}) {
    Add(name, help, MetricType::Counter, std::move(labels)).counter.value =
        static_cast<double>(value);
  }
  void Gauge(const std::string& name, const std::string& help, double value, Labels labels = {}) {
    Add(name, help, MetricType::Gauge, std::move(labels)).gauge.value = value;
  }
  std::vector<MetricFamily> Take() { return std::move(families_); }

 private:
  ClientMetric& Add(const std::string& name, const std::string& help, MetricType type,
                    Labels labels) {
    const std::string full_name = "splinemapd_" + name;
    if (families_.empty() || families_.back().name != full_name) {
      families_.push_back({full_name, help, type, {}});
    }
    ClientMetric& metric = families_.back().metric.emplace_back();
    metric.label = std::move(labels);
    return metric;
  }

  std::vector<MetricFamily> families_;
};

// Of those that occurred.
std::map<std::string, int64_t> CountsOf(const std::vector<std::string>& names,
                                        const std::vector<int64_t>& counts) {
  std::map<std::string, int64_t> by_name;
  for (size_t k = 0; k < names.size(); ++k) by_name[names[k]] = counts[k];
  return by_name;
}

std::string LayerLabel(const layer_status_t& layer) {
  return fmt::format("{}@{:016x}", PlainText(layer.settings.name),
                     static_cast<uint64_t>(layer.settings.origin));
}

void AddMessages(const status_t& status, Families& families) {
  families.Count("messages_received_total", "Messages on the channels of scans and poses",
                 status.messages_received);
  families.Count("received_bytes_total", "Bytes of those messages", status.bytes_received);
  families.Count("scans_received_total", "Scans received", status.scans_received);
  families.Count("scans_mapped_total", "Scans that are in the map", status.scans_mapped);
  families.Count("poses_received_total", "Poses received", status.poses_received);
  families.Count("beams_received_total", "Readings of all scans received", status.beams_received);
  families.Count("beams_mapped_total", "Readings that are in the map", status.beams_mapped);
  // Those that did not occur are 0, so that the first one is an increase.
  auto drops = CountsOf(status.drop_reasons, status.drop_counts);
  for (int k = 0; k < kNumDropReasons; ++k) {
    const std::string reason = DropName(static_cast<DropReason>(k));
    families.Count("messages_dropped_total", "Messages that were not mapped, by reason",
                   drops[reason], {{"reason", reason}});
  }
  auto problems = CountsOf(status.problems, status.problem_counts);
  for (int k = 0; k < kNumProblems; ++k) {
    const std::string problem = ProblemName(static_cast<Problem>(k));
    families.Count("problems_total", "Problems found, by name; RUNBOOK.md says what to do",
                   problems[problem], {{"problem", problem}});
  }
}

void AddMap(const status_t& status, Families& families) {
  families.Gauge("messages_queued", "Messages received and not mapped yet", status.messages_queued);
  families.Gauge("scans_queued", "Scans that wait for a pose", status.scans_queued);
  if (status.newest_scan_age_s >= 0) {
    families.Gauge("newest_scan_age_seconds", "Time since a scan was mapped",
                   status.newest_scan_age_s);
  }
  families.Gauge("scan_time_mean_seconds", "Time to map a scan, mean of the last second",
                 status.scan_time_mean_ms * 1e-3);
  families.Gauge("scan_time_max_seconds", "Time to map a scan, greatest of the last second",
                 status.scan_time_max_ms * 1e-3);
  families.Gauge("commits", "Commits to the own layer", static_cast<double>(status.revision));
  families.Gauge("commits_saved", "Commits that are on disk",
                 static_cast<double>(status.saved_revision));
  families.Gauge("tiles", "Tiles of the own layer", static_cast<double>(status.tiles));
  families.Gauge("map_bytes", "Memory of the tiles of the own layer",
                 static_cast<double>(status.map_bytes));
}

void AddLayers(const layers_t& layers, Families& families) {
  families.Gauge("layers_refused", "Layers that cannot be summed", layers.num_refused);
  for (const layer_status_t& layer : layers.layers) {
    families.Gauge("layer_tiles", "Tiles of a layer; state: own, live, stale, gone or removed",
                   static_cast<double>(layer.num_tiles),
                   {{"layer", LayerLabel(layer)}, {"state", layer.state}});
  }
  for (const layer_status_t& layer : layers.layers) {
    if (layer.heard_s_ago < 0) continue;
    families.Gauge("layer_heard_seconds", "Time since the owner of a layer spoke",
                   layer.heard_s_ago, {{"layer", LayerLabel(layer)}});
  }
}

class DaemonMetrics : public prometheus::Collectable {
 public:
  explicit DaemonMetrics(const Daemon& daemon) : daemon_(daemon) {}
  std::vector<MetricFamily> Collect() const override {
    const auto published = daemon_.published();
    return published == nullptr ? std::vector<MetricFamily>() : MetricsOf(*published);
  }

 private:
  const Daemon& daemon_;
};

}  // namespace

std::vector<MetricFamily> MetricsOf(const Daemon::Published& published) {
  const status_t& status = published.status;
  Families families;
  families.Gauge("info", "1, with the version and the robot", 1,
                 {{"version", status.version}, {"robot", PlainText(status.name)}});
  families.Gauge("uptime_seconds", "Time since the start", status.uptime_s);
  AddMessages(status, families);
  AddMap(status, families);
  AddLayers(published.layers, families);
  return families.Take();
}

absl::StatusOr<std::unique_ptr<MetricsServer>> MetricsServer::Listen(uint32_t port,
                                                                     const Daemon& daemon) {
  const std::string address = fmt::format("127.0.0.1:{}", port);
  std::unique_ptr<MetricsServer> server(new MetricsServer);
  try {
    server->exposer_ = std::make_unique<prometheus::Exposer>(address, /*num_threads=*/1);
  } catch (const std::exception& exception) {
    return Unavailable("metrics cannot be served at {}: is another program there? {}", address,
                       exception.what());
  }
  server->metrics_ = std::make_shared<DaemonMetrics>(daemon);
  server->exposer_->RegisterCollectable(server->metrics_);
  return server;
}

MetricsServer::~MetricsServer() = default;

}  // namespace splinemap
