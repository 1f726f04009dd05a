#include "lib/fleet/query_tiles.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "lib/base/status.h"
#include "lib/geometry/angle.h"

namespace splinemap {
namespace {

// Of rounding, and of what queries look at beside what they ask for, in knot intervals.
constexpr double kMargin = 2;
// Of one item: some 100 km of a path.
constexpr double kMaxPieces = 1 << 16;

// All that searches within `reach` of the box look at: bounds of tiles are made of those around.
TileBox TilesAround(const Eigen::Vector2d& a_m, const Eigen::Vector2d& b_m, double reach_m,
                    double knot_interval_m) {
  const double margin_m = reach_m + kMargin * knot_interval_m;
  const Eigen::Vector2d low_m = a_m.cwiseMin(b_m) - Eigen::Vector2d::Constant(margin_m);
  const Eigen::Vector2d high_m = a_m.cwiseMax(b_m) + Eigen::Vector2d::Constant(margin_m);
  const TileBox box = TilesOf({low_m.x(), low_m.y(), high_m.x(), high_m.y()}, knot_interval_m);
  return {box.tx0 - 1, box.ty0 - 1, box.tx1 + 1, box.ty1 + 1};
}

bool IsOnMap(const Eigen::Vector2d& point_m, double knot_interval_m) {
  return LocateKnot(point_m.x(), knot_interval_m) && LocateKnot(point_m.y(), knot_interval_m);
}

// The tiles along a way, piece by piece. What looks at a box around a part of the way finds nothing
// in the corners of it, which these need not have.
absl::Status AddWay(const Eigen::Vector2d& from_m, const Eigen::Vector2d& to_m, double reach_m,
                    double knot_interval_m, TileBoxes& boxes) {
  const double length_m = (to_m - from_m).norm();
  const double piece_m = std::max(Tile::kSide * knot_interval_m, reach_m);
  const double pieces = std::max(std::ceil(length_m / piece_m), 1.0);
  if (!(static_cast<double>(boxes.size()) + pieces <= kMaxPieces)) {
    return InvalidArgument(
        "a ray or path of {:g} m is too long for the map of a fleet: ask for {:g} m at most",
        length_m, std::floor(kMaxPieces * piece_m));
  }
  const auto at = [&](double piece) {
    return Eigen::Vector2d(from_m + std::min(piece / pieces, 1.0) * (to_m - from_m));
  };
  for (double piece = 0; piece < pieces; ++piece) {
    boxes.push_back(TilesAround(at(piece), at(piece + 1), reach_m, knot_interval_m));
  }
  return absl::OkStatus();
}

int32_t SquareOf(int32_t tile) { return tile >> 5; }
static_assert(kSquareSide == 1 << 5);

// Where runs of columns (rows) of a raster end that have their tiles in the same squares.
// `tiles_of(k)` gives the tiles [first, second) of column k.
template <typename TilesOfColumn>
std::vector<int32_t> EndsOfRuns(int32_t size, TilesOfColumn tiles_of) {
  std::vector<int32_t> ends;
  std::pair<int32_t, int32_t> before;
  for (int32_t k = 0; k < size; ++k) {
    const auto [begin, end] = tiles_of(k);
    const std::pair squares(SquareOf(begin), SquareOf(end - 1));
    if (k > 0 && squares != before) ends.push_back(k);
    before = squares;
  }
  ends.push_back(size);
  return ends;
}

}  // namespace

absl::StatusOr<TileBoxes> TilesOfItem(const PointsQuery& query, size_t item,
                                      double knot_interval_m) {
  const Eigen::Vector2d& point_m = query.points_m[item];
  if (!IsOnMap(point_m, knot_interval_m)) return TileBoxes{};
  return TileBoxes{TilesOf({point_m.x(), point_m.y(), point_m.x(), point_m.y()}, knot_interval_m)};
}

absl::StatusOr<TileBoxes> TilesOfItem(const RaysQuery& query, size_t item, double knot_interval_m) {
  const Ray& ray = query.rays[item];
  TileBoxes boxes;
  SPLINEMAP_RETURN_IF_ERROR(AddWay(ray.origin_m,
                                   ray.origin_m + ray.max_range_m * UnitVector(ray.bearing_rad), 0,
                                   knot_interval_m, boxes));
  return boxes;
}

absl::StatusOr<TileBoxes> TilesOfItem(const SweepsQuery& query, size_t item,
                                      double knot_interval_m) {
  const Sweep& sweep = query.sweeps[item];
  TileBoxes boxes;
  for (size_t k = 0; k < std::max<size_t>(sweep.path_m.size() - 1, 1); ++k) {
    const size_t next = std::min(k + 1, sweep.path_m.size() - 1);
    SPLINEMAP_RETURN_IF_ERROR(
        AddWay(sweep.path_m[k], sweep.path_m[next], sweep.radius_m, knot_interval_m, boxes));
  }
  return boxes;
}

absl::StatusOr<TileBoxes> TilesOfItem(const RasterCells& query, size_t item,
                                      double knot_interval_m) {
  const RasterCells::Rectangle& rectangle = query.rectangles[item];
  const auto at = [&](int32_t column, int32_t row) {
    return PointOfCell(query.raster, size_t{1} * row * query.raster.width + column);
  };
  const Eigen::Vector2d low_m = at(rectangle.column0, rectangle.row0);
  const Eigen::Vector2d high_m = at(rectangle.column1 - 1, rectangle.row1 - 1);
  return TileBoxes{TilesOf({low_m.x(), low_m.y(), high_m.x(), high_m.y()}, knot_interval_m)};
}

absl::StatusOr<TileBoxes> TilesOfItem(const LikelihoodsQuery& query, size_t item,
                                      double knot_interval_m) {
  const Pose2& world_T_robot = query.world_T_robot[item];
  TileBoxes boxes;
  TileBox around;
  for (const Eigen::Vector2d& hit_m : query.hits_robot_m) {
    const Eigen::Vector2d point_m = world_T_robot * hit_m;
    if (!IsOnMap(point_m, knot_interval_m)) continue;
    const TileBox box =
        TilesOf({point_m.x(), point_m.y(), point_m.x(), point_m.y()}, knot_interval_m);
    around.Add({box.tx0, box.ty0});
    around.Add({box.tx1 - 1, box.ty1 - 1});
  }
  if (!around.IsEmpty()) boxes.push_back(around);
  return boxes;
}

absl::StatusOr<TileBoxes> TilesOfItem(const DistancesQuery& query, size_t item,
                                      double knot_interval_m) {
  const Eigen::Vector2d& point_m = query.points_m[item];
  return TileBoxes{TilesAround(point_m, point_m, query.max_distance_m, knot_interval_m)};
}

absl::StatusOr<TileBoxes> TilesOfItem(const BlocksQuery& query, size_t item,
                                      double /*knot_interval_m*/) {
  return TileBoxes{query.blocks[item].Tiles()};
}

PartSet PartsOf(const TileBoxes& boxes) {
  PartSet parts;
  for (const TileBox& box : boxes) {
    // Squares are dealt out anew after 8.
    constexpr int32_t kPeriod = 8;
    const int32_t x0 = SquareOf(box.tx0);
    const int32_t y0 = SquareOf(box.ty0);
    const int32_t x1 = std::min(SquareOf(box.tx1 - 1) + 1, x0 + kPeriod);
    const int32_t y1 = std::min(SquareOf(box.ty1 - 1) + 1, y0 + kPeriod);
    for (int32_t y = y0; y < y1; ++y) {
      for (int32_t x = x0; x < x1; ++x) {
        parts.set(static_cast<size_t>(PartOf(TileKey{kSquareSide * x, kSquareSide * y})));
      }
    }
  }
  return parts;
}

absl::StatusOr<RasterCells> RectanglesOf(const RasterQuery& query, double knot_interval_m) {
  constexpr size_t kMaxRectangles = size_t{1} << 22;
  const auto tiles_of = [&](int32_t column, int32_t row) {
    const Eigen::Vector2d at_m = PointOfCell(query, size_t{1} * row * query.width + column);
    return TilesOf({at_m.x(), at_m.y(), at_m.x(), at_m.y()}, knot_interval_m);
  };
  const std::vector<int32_t> columns = EndsOfRuns(query.width, [&](int32_t column) {
    const TileBox box = tiles_of(column, 0);
    return std::pair(box.tx0, box.tx1);
  });
  const std::vector<int32_t> rows = EndsOfRuns(query.height, [&](int32_t row) {
    const TileBox box = tiles_of(0, row);
    return std::pair(box.ty0, box.ty1);
  });
  if (columns.size() * rows.size() > kMaxRectangles) {
    return InvalidArgument(
        "a raster of {} x {} cells of {:g} m is too much for the map of a fleet: ask for a part of "
        "it, or follow the map",
        query.width, query.height, query.resolution_m);
  }
  RasterCells cells{.raster = query, .rectangles = {}};
  constexpr auto kMaxCells = static_cast<int32_t>(RasterCells::kMaxCells);
  int32_t row0 = 0;
  for (const int32_t row1 : rows) {
    int32_t column0 = 0;
    for (const int32_t column1 : columns) {
      // So small that one request can ask for it.
      const int32_t width = std::min(column1 - column0, kMaxCells);
      const int32_t height = std::min(row1 - row0, kMaxCells / width);
      for (int32_t row = row0; row < row1; row += height) {
        for (int32_t column = column0; column < column1; column += width) {
          cells.rectangles.push_back(
              {column, row, std::min(column + width, column1), std::min(row + height, row1)});
        }
      }
      column0 = column1;
    }
    row0 = row1;
  }
  return cells;
}

}  // namespace splinemap
