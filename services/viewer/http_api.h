#pragma once

#include <functional>
#include <string>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "services/viewer/http_target.h"
#include "services/viewer/shown_map.h"
#include "services/viewer/sum_levels.h"
#include "splinemap/pose2.h"

namespace splinemap {

struct HttpAnswer {
  int status = 200;
  std::string content_type = "application/json";
  std::string body;
};

// {"error": ..} with the status of HTTP that fits.
HttpAnswer ErrorAnswer(const absl::Status& status);

// What can be asked over HTTP beside the page; README.md has a line of curl for each. Thread-safe.
class HttpApi {
 public:
  static constexpr int kMaxPictureSide = 4096;  // pixels

  // Both outlive it.
  HttpApi(const ShownMap& map, const SumLevels& sum) : map_(map), sum_(sum) {}

  HttpAnswer Get(const HttpTarget& target) const;

 private:
  absl::StatusOr<HttpAnswer> Answer(const HttpTarget& target) const;
  absl::StatusOr<HttpAnswer> Query(const HttpTarget& target) const;
  absl::StatusOr<HttpAnswer> Ray(const HttpTarget& target) const;
  absl::StatusOr<HttpAnswer> Distance(const HttpTarget& target) const;
  absl::StatusOr<HttpAnswer> Check(const HttpTarget& target) const;
  absl::StatusOr<HttpAnswer> Picture(const HttpTarget& target) const;
  absl::StatusOr<HttpAnswer> WebTile(const HttpTarget& target) const;
  absl::StatusOr<HttpAnswer> Render(double left_m, double top_m, double pixel_m, int width,
                                    int height) const;

  const ShownMap& map_;
  const SumLevels& sum_;
};

}  // namespace splinemap
