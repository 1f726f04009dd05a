#pragma once

#include <prometheus/counter.h>
#include <prometheus/gauge.h>
#include <prometheus/registry.h>

#include <string>

namespace splinemap {

// What /metrics shows. Thread-safe.
class Metrics {
 public:
  // In the text format of Prometheus.
  std::string Text() const;

 private:
  prometheus::Registry registry_;

 public:
  prometheus::Gauge& browsers;
  prometheus::Gauge& connections;
  prometheus::Gauge& tiles;
  prometheus::Gauge& revision;
  prometheus::Gauge& bytes_from_bus;
  prometheus::Counter& frames;
  prometheus::Counter& frame_bytes;
  prometheus::Counter& requests;
  prometheus::Counter& refused;

  Metrics();
};

}  // namespace splinemap
