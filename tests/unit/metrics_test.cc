#include "services/splinemapd/metrics.h"

#include <gtest/gtest.h>
#include <prometheus/text_serializer.h>

#include <string>

#include "lib/pipeline/notice.h"
#include "lib/sensing/drop_counts.h"

namespace splinemap::metrics_test {

Daemon::Published Example() {
  Daemon::Published published;
  status_t& status = published.status;
  status.name = "robot";
  status.version = "1.2.3";
  status.scans_mapped = 12;
  status.newest_scan_age_s = -1;
  status.scan_time_max_ms = 1.5;
  status.num_drop_reasons = 1;
  status.drop_reasons = {"late_scan"};
  status.drop_counts = {7};
  status.num_problems = 1;
  status.problems = {"silence"};
  status.problem_counts = {2};
  return published;
}

layer_status_t LayerOf(const std::string& name, const std::string& state, double heard_s_ago) {
  layer_status_t layer{};
  layer.settings.name = name;
  layer.settings.origin = 0x1f;
  layer.state = state;
  layer.num_tiles = 3;
  layer.heard_s_ago = heard_s_ago;
  return layer;
}

// A line each, as Prometheus reads them.
std::string TextOf(const Daemon::Published& published) {
  return "\n" + prometheus::TextSerializer().Serialize(MetricsOf(published));
}

bool Has(const std::string& text, const std::string& line) {
  return text.find("\n" + line + "\n") != std::string::npos;
}

TEST(MetricsTest, EveryDropReasonAndProblemIsThereThoughItNeverOccurred) {
  const std::string text = TextOf(Example());
  for (int k = 0; k < kNumDropReasons; ++k) {
    const std::string reason = DropName(static_cast<DropReason>(k));
    const std::string count = reason == "late_scan" ? "7" : "0";
    EXPECT_TRUE(Has(text, "splinemapd_messages_dropped_total{reason=\"" + reason + "\"} " + count))
        << text;
  }
  for (int k = 0; k < kNumProblems; ++k) {
    const std::string problem = ProblemName(static_cast<Problem>(k));
    const std::string count = problem == "silence" ? "2" : "0";
    EXPECT_TRUE(Has(text, "splinemapd_problems_total{problem=\"" + problem + "\"} " + count))
        << text;
  }
}

TEST(MetricsTest, UnitsAreSecondsAndWhatThereIsNotIsLeftOut) {
  const std::string text = TextOf(Example());
  EXPECT_TRUE(Has(text, "# TYPE splinemapd_scans_mapped_total counter")) << text;
  EXPECT_TRUE(Has(text, "splinemapd_scans_mapped_total 12")) << text;
  EXPECT_TRUE(Has(text, "splinemapd_scan_time_max_seconds 0.0015")) << text;
  EXPECT_EQ(text.find("newest_scan_age"), std::string::npos) << text;
}

TEST(MetricsTest, NamesOfTheBusArePlainTextInLabels) {
  Daemon::Published published = Example();
  published.layers.layers = {LayerOf("a\"} 1\nevil_total 9", "live", 0.5),
                             LayerOf("b\x1b[31m\xff", "removed", -1)};
  published.layers.num_layers = 2;
  const std::string text = TextOf(published);
  EXPECT_EQ(text.find("\nevil"), std::string::npos) << text;
  EXPECT_TRUE(Has(text,
                  R"(splinemapd_layer_tiles{layer="a\"} 1\\x0aevil_total 9@000000000000001f",)"
                  R"(state="live"} 3)"))
      << text;
  EXPECT_TRUE(Has(text, R"(splinemapd_layer_tiles{layer="b\\x1b[31m\\xff@000000000000001f",)"
                        R"(state="removed"} 3)"))
      << text;
  EXPECT_NE(text.find("splinemapd_layer_heard_seconds{layer=\"a"), std::string::npos) << text;
  EXPECT_EQ(text.find("splinemapd_layer_heard_seconds{layer=\"b"), std::string::npos) << text;
}

}  // namespace splinemap::metrics_test
