#include "tests/bench/align/feature_matcher.h"

#include <cmath>
#include <opencv2/features2d.hpp>
#include <opencv2/stitching/detail/matchers.hpp>
#include <vector>

#include "splinemap/region.h"

namespace splinemap {
namespace {

constexpr double kCell_m = 0.05;
constexpr double kConfidence = 1;

struct Grid {
  cv::Mat cells;
  Eigen::Vector2d origin_m;  // the middle of the first cell
};

Grid GridOf(const MapView& map) {
  TileBox box;
  map.tiles.ForEach([&](TileKey key, const TileTree::Entry&) { box.Add(key); });
  const double side_m = Tile::kSide * map.options.knot_interval_m;
  const int width = static_cast<int>((box.tx1 - box.tx0) * side_m / kCell_m);
  const int height = static_cast<int>((box.ty1 - box.ty0) * side_m / kCell_m);
  Grid grid{cv::Mat(height, width, CV_8UC1), {box.tx0 * side_m, box.ty0 * side_m}};
  std::vector<Eigen::Vector2d> points_m(width);
  std::vector<SurfaceSample> samples(width);
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) {
      points_m[x] = grid.origin_m + kCell_m * Eigen::Vector2d(x, y);
    }
    map.EvaluateMany(points_m, absl::MakeSpan(samples));
    for (int x = 0; x < width; ++x) {
      grid.cells.at<uint8_t>(y, x) = !samples[x].known ? 255 : samples[x].log_odds > 0 ? 100 : 0;
    }
  }
  return grid;
}

}  // namespace

std::optional<Pose2> AlignByFeatures(const MapView& a, const MapView& b) {
  cv::setNumThreads(1);
  const Grid grids[] = {GridOf(a), GridOf(b)};
  const cv::Ptr<cv::Feature2D> finder = cv::AKAZE::create();
  std::vector<cv::detail::ImageFeatures> features(2);
  for (int k = 0; k < 2; ++k) {
    cv::detail::computeImageFeatures(finder, grids[k].cells, features[k]);
  }
  cv::detail::AffineBestOf2NearestMatcher matcher;
  cv::detail::MatchesInfo match;
  if (features[0].keypoints.size() < 2 || features[1].keypoints.size() < 2) return std::nullopt;
  matcher(features[1], features[0], match);  // from b to a
  if (match.confidence < kConfidence || match.H.empty()) return std::nullopt;
  const double yaw_rad = std::atan2(match.H.at<double>(1, 0), match.H.at<double>(0, 0));
  // It may scale, too: what it does to the middle of b counts, so that scales cost it nothing.
  const double x = (grids[1].cells.cols - 1) / 2.0;
  const double y = (grids[1].cells.rows - 1) / 2.0;
  const Eigen::Vector2d in_a(
      match.H.at<double>(0, 0) * x + match.H.at<double>(0, 1) * y + match.H.at<double>(0, 2),
      match.H.at<double>(1, 0) * x + match.H.at<double>(1, 1) * y + match.H.at<double>(1, 2));
  const Pose2 turn{Eigen::Vector2d::Zero(), yaw_rad};
  const Eigen::Vector2d middle_b_m = grids[1].origin_m + kCell_m * Eigen::Vector2d(x, y);
  const Eigen::Vector2d middle_a_m = grids[0].origin_m + kCell_m * in_a;
  return Pose2{middle_a_m - turn * middle_b_m, yaw_rad};
}

}  // namespace splinemap
