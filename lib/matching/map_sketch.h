#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <vector>

#include "absl/status/statusor.h"
#include "splinemap/map_view.h"
#include "splinemap/region.h"
#include "splinemap/tile.h"

namespace splinemap {

// Of maps that are matched, all lengths are multiples of the wider of their knot intervals.
struct MatchScale {
  double knot_m;

  // Up to that a face pulls on what is to fit it.
  double Reach() const { return 10 * knot_m; }
  // Faces that are no further apart are one.
  double Same() const { return 2 * knot_m; }
  // Free space without a face that near is open.
  double Clearance() const { return 6 * knot_m; }
  // A face that is not there has free space before it and that far behind it.
  double Behind() const { return 4 * knot_m; }
};

// A point of a face: the surface of a map is 0 there, with free space before it.
struct WallPoint {
  Eigen::Vector2d point_m;
  Eigen::Vector2d normal;  // out of free space, into the thing; length 1
  double length_m;         // of the face that it stands for
};

// The least slope of a surface at a face, in log-odds a knot interval.
inline constexpr double kLeastFaceSlope = 1.5;

// What a map has at a vertex of its knot grid.
struct SketchVertex {
  static constexpr int32_t kNone = -1;

  int32_t wall = kNone;  // the nearest of MapSketch::walls(), within MatchScale::Reach()
  bool is_known = false;
  bool is_free = false;
  bool is_open = false;  // free, and no wall within MatchScale::Clearance()
};

// What one map has to say to another: its faces, and at the vertices of its knot grid what is free.
// Immutable.
class MapSketch {
 public:
  using Vertex = SketchVertex;

  // FailedPrecondition for a map without faces, and for one whose tiles lie too far apart.
  static absl::StatusOr<MapSketch> Of(const MapView& map, const MatchScale& scale);

  double knot_m() const { return knot_m_; }
  const std::vector<WallPoint>& walls() const { return walls_; }
  double wall_m() const { return wall_m_; }  // length of all of them

  // The vertex nearest to a point.
  const Vertex& At(const Eigen::Vector2d& point_m) const {
    const double x = point_m.x() / knot_m_ + 0.5 - first_i_;
    const double y = point_m.y() / knot_m_ + 0.5 - first_j_;
    if (!(x >= 0 && y >= 0 && x < width_ && y < height_)) return kUnknown;
    return At(static_cast<int>(x), static_cast<int>(y));
  }

  // Calls f(point_m, vertex) for each vertex that is known, in an order that the map decides.
  template <typename F>
  void ForEachKnown(F f) const {
    for (size_t block = 0; block < keys_.size(); ++block) {
      for (int k = 0; k < Tile::kSize; ++k) {
        if (blocks_[block][k].is_known) f(PointOf(keys_[block], k), blocks_[block][k]);
      }
    }
  }

 private:
  using Block = std::array<Vertex, Tile::kSize>;  // of a tile
  static constexpr Vertex kUnknown{};

  explicit MapSketch(double knot_m) : knot_m_(knot_m) {}

  absl::Status Index(const MapView& map);
  std::vector<float> ReadVertices(const MapView& map);
  void FindWalls(const MapView& map, const std::vector<float>& values);
  void SpreadWalls(const MatchScale& scale);

  Eigen::Vector2d PointOf(TileKey key, int k) const {
    return {knot_m_ * (Tile::kSide * key.tx + k % Tile::kSide),
            knot_m_ * (Tile::kSide * key.ty + k / Tile::kSide)};
  }
  // From the first vertex of the box; in the box.
  int BlockOf(int x, int y) const {
    return directory_[size_t{1} * (y / Tile::kSide) * (width_ / Tile::kSide) + x / Tile::kSide];
  }
  const Vertex& At(int x, int y) const {
    const int block = BlockOf(x, y);
    return block < 0 ? kUnknown : blocks_[block][IndexInTile(x, y)];
  }

  double knot_m_;
  // The box of the tiles, in knot intervals, and which block belongs to each of it; -1: none.
  int32_t first_i_ = 0;
  int32_t first_j_ = 0;
  int32_t width_ = 0;
  int32_t height_ = 0;
  std::vector<int32_t> directory_;
  std::vector<TileKey> keys_;
  std::vector<Block> blocks_;
  std::vector<WallPoint> walls_;
  double wall_m_ = 0;
};

}  // namespace splinemap
