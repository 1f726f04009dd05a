#include "lib/matching/pose_search.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <complex>
#include <limits>
#include <numbers>
#include <tuple>
#include <utility>

#include "lib/base/status.h"
#include "lib/geometry/angle.h"
#include "lib/matching/fft.h"

namespace splinemap {
namespace {

using Eigen::Vector2d;

// Knot intervals. Larger maps have larger cells.
constexpr double kCells[] = {8, 11.3, 16};
constexpr int kMostCells = 512;  // each way
// Cells that the outermost points of b move from one heading to the next.
constexpr double kHeadingStep = 1.5;
// Of what contradicts against what agrees; true places have some, more so in coarse cells.
constexpr float kContradictionWeight = 0.2F;
// Walls further out at each side of a map, as a share of all, are left out: rays through windows
// would make it large.
constexpr double kOutlyingWalls = 0.005;
constexpr size_t kMostPoses = 300;

constexpr double kInfinity = std::numeric_limits<double>::infinity();

struct Box {
  Vector2d low_m{kInfinity, kInfinity};
  Vector2d high_m{-kInfinity, -kInfinity};

  bool Contains(const Vector2d& p) const {
    return p.x() >= low_m.x() && p.y() >= low_m.y() && p.x() <= high_m.x() && p.y() <= high_m.y();
  }
  Vector2d Middle() const { return (low_m + high_m) / 2; }
};

Box BoxOfWalls(const MapSketch& map) {
  Box box;
  for (int axis = 0; axis < 2; ++axis) {
    std::vector<std::pair<double, double>> walls;
    for (const WallPoint& wall : map.walls()) {
      walls.emplace_back(wall.point_m[axis], wall.length_m);
    }
    std::sort(walls.begin(), walls.end());
    double sum_m = 0;
    for (const auto& [coordinate_m, length_m] : walls) {
      if (sum_m <= kOutlyingWalls * map.wall_m()) box.low_m[axis] = coordinate_m;
      box.high_m[axis] = coordinate_m;
      sum_m += length_m;
      if (sum_m >= (1 - kOutlyingWalls) * map.wall_m()) break;
    }
  }
  return box;
}

// As complex numbers: the square of that of the direction.
Vector2d Doubled(const Vector2d& unit) {
  return {unit.x() * unit.x() - unit.y() * unit.y(), 2 * unit.x() * unit.y()};
}

// What lies in a square of a map, at its middle.
struct Mark {
  Vector2d point_m = Vector2d::Zero();
  double amount = 0;
  Vector2d doubled = Vector2d::Zero();  // sum of amounts times doubled directions
};

// Gathers what lies in squares of one side.
class Marks {
 public:
  Marks(const Box& box, double side_m)
      : box_(box),
        side_m_(side_m),
        width_(CellsIn(box.high_m.x() - box.low_m.x())),
        marks_(size_t{1} * width_ * CellsIn(box.high_m.y() - box.low_m.y())) {}

  void Add(const Vector2d& p, double amount, const Vector2d& doubled = Vector2d::Zero()) {
    if (!box_.Contains(p)) return;
    const auto x = static_cast<int>((p.x() - box_.low_m.x()) / side_m_);
    const auto y = static_cast<int>((p.y() - box_.low_m.y()) / side_m_);
    Mark& mark = marks_[size_t{1} * y * width_ + x];
    mark.point_m += amount * p;
    mark.amount += amount;
    mark.doubled += amount * doubled;
  }
  std::vector<Mark> Take() {
    std::erase_if(marks_, [](const Mark& mark) { return mark.amount == 0; });
    for (Mark& mark : marks_) mark.point_m /= mark.amount;
    return std::move(marks_);
  }

 private:
  int CellsIn(double length_m) const { return static_cast<int>(length_m / side_m_) + 1; }

  Box box_;
  double side_m_;
  int width_;
  std::vector<Mark> marks_;
};

struct MarkedMap {
  Box box;
  std::vector<Mark> walls;   // metres
  std::vector<Mark> behind;  // metres of wall, where something has to be
  std::vector<Mark> open;    // square metres
};

MarkedMap MarkedMapOf(const MapSketch& map, const Box& box, const MatchScale& scale,
                      double cell_m) {
  Marks walls(box, cell_m / 2);
  Marks behind(box, cell_m / 2);
  Marks open(box, cell_m);
  for (const WallPoint& wall : map.walls()) {
    walls.Add(wall.point_m, wall.length_m, Doubled(wall.normal));
    behind.Add(wall.point_m + scale.Behind() * wall.normal, wall.length_m);
  }
  map.ForEachKnown([&](const Vector2d& p, const MapSketch::Vertex& vertex) {
    if (vertex.is_open) open.Add(p, map.knot_m() * map.knot_m());
  });
  return {box, walls.Take(), behind.Take(), open.Take()};
}

// Cells of a grid that is cyclic in both directions.
class CyclicCells {
 public:
  CyclicCells(int width, int height) : width_(width), height_(height) {}

  // Of a cell that is less than the width and height outside.
  size_t Index(int x, int y) const {
    const int u = x < 0 ? x + width_ : x >= width_ ? x - width_ : x;
    const int v = y < 0 ? y + height_ : y >= height_ ? y - height_ : y;
    return size_t{1} * v * width_ + u;
  }
  // Calls f(index, share) for the four cells around a point.
  template <typename F>
  void Share(const Vector2d& cells, F f) const {
    const auto x = static_cast<int>(FloorToInt(cells.x()));
    const auto y = static_cast<int>(FloorToInt(cells.y()));
    const auto right = static_cast<float>(cells.x() - x);
    const auto up = static_cast<float>(cells.y() - y);
    f(Index(x, y), (1 - right) * (1 - up));
    f(Index(x + 1, y), right * (1 - up));
    f(Index(x, y + 1), (1 - right) * up);
    f(Index(x + 1, y + 1), right * up);
  }
  // The distance of two columns, and of two rows.
  bool AreNeighbours(int x0, int y0, int x1, int y1) const {
    return Apart(x0, x1, width_) <= 1 && Apart(y0, y1, height_) <= 1;
  }
  static int Apart(int p, int q, int size) {
    const int d = std::abs(p - q);
    return std::min(d, size - d);
  }

 private:
  int width_;
  int height_;
};

struct Peak {
  float score_m;
  int heading;
  int x;
  int y;

  // The best first.
  bool operator<(const Peak& other) const {
    return std::tie(other.score_m, heading, y, x) <
           std::tie(score_m, other.heading, other.y, other.x);
  }
};

class PoseSearch {
 public:
  PoseSearch(MarkedMap a, MarkedMap b, double cell_m, double radius_m, int width, int height);

  std::vector<Pose2> Run(const std::function<void(double share)>& on_progress);

 private:
  using Complex = std::complex<float>;

  // Two headings at once: the correlation of the first is real, that of the second imaginary.
  static constexpr int kAtOnce = 2;

  Vector2d CellsInA(const Vector2d& p) const { return (p - a_.box.low_m) / cell_m_; }
  double HeadingOf(int n) const { return 2 * std::numbers::pi * n / headings_; }
  void DrawA();
  void DrawB(int heading, ComplexGrid& walls, ComplexGrid& behind_and_open) const;
  void Correlate(int heading);
  void AddPeaks(int heading);
  void KeepBestPeaks(size_t most);
  Pose2 PoseOf(const Peak& peak) const;

  const MarkedMap a_;
  const MarkedMap b_;
  const double cell_m_;
  const double radius_m_;  // of b about the middle of its box
  const int width_;
  const int height_;
  const int headings_;
  const CyclicCells cells_;
  GridFft fft_;
  // Of a: directions of walls, fading out to the sides; free space; places behind walls.
  ComplexGrid walls_a_;
  ComplexGrid open_a_;
  ComplexGrid behind_a_;
  std::array<ComplexGrid, kAtOnce> walls_b_;
  std::array<ComplexGrid, kAtOnce> behind_and_open_b_;
  ComplexGrid product_;
  std::vector<float> scores_;  // metres, of one heading
  std::vector<Peak> peaks_;
  float least_m_ = 0;  // lower peaks are none
};

PoseSearch::PoseSearch(MarkedMap a, MarkedMap b, double cell_m, double radius_m, int width,
                       int height)
    : a_(std::move(a)),
      b_(std::move(b)),
      cell_m_(cell_m),
      radius_m_(radius_m),
      width_(width),
      height_(height),
      headings_(kAtOnce * static_cast<int>(std::ceil(std::numbers::pi / kHeadingStep *
                                                     std::max(radius_m / cell_m, 1.0)))),
      cells_(width, height),
      walls_a_(width, height),
      open_a_(width, height),
      behind_a_(width, height),
      walls_b_{ComplexGrid(width, height), ComplexGrid(width, height)},
      behind_and_open_b_{ComplexGrid(width, height), ComplexGrid(width, height)},
      product_(width, height),
      scores_(product_.cells.size()) {
  DrawA();
}

void PoseSearch::DrawA() {
  // A wall fades out over so many cells. One through the middle of a cell is full; more is no
  // better.
  constexpr double kFade = 1.5;
  constexpr double kFull = 0.3;
  std::vector<float> weights(walls_a_.cells.size());
  for (const Mark& mark : a_.walls) {
    const Vector2d p = CellsInA(mark.point_m);
    const auto x = static_cast<int>(FloorToInt(p.x()));
    const auto y = static_cast<int>(FloorToInt(p.y()));
    for (int v = y - 1; v <= y + 2; ++v) {
      for (int u = x - 1; u <= x + 2; ++u) {
        const double share = 1 - (Vector2d(u, v) - p).norm() / kFade;
        if (share <= 0) continue;
        const size_t index = cells_.Index(u, v);
        weights[index] += static_cast<float>(share * mark.amount);
        walls_a_.cells[index] += Complex(static_cast<float>(share * mark.doubled.x()),
                                         static_cast<float>(share * mark.doubled.y()));
      }
    }
  }
  for (size_t k = 0; k < weights.size(); ++k) {
    walls_a_.cells[k] /= std::max(weights[k], static_cast<float>(kFull * cell_m_));
  }
  for (const Mark& mark : a_.open) {
    const auto share_of_cell = static_cast<float>(mark.amount / (cell_m_ * cell_m_));
    cells_.Share(CellsInA(mark.point_m),
                 [&](size_t k, float share) { open_a_.cells[k] += share * share_of_cell; });
  }
  for (const Mark& mark : a_.behind) {
    const auto length_m = static_cast<float>(mark.amount);
    cells_.Share(CellsInA(mark.point_m),
                 [&](size_t k, float share) { behind_a_.cells[k] += share * length_m; });
  }
  fft_.Forward(walls_a_);
  fft_.Forward(open_a_);
  fft_.Forward(behind_a_);
}

// The middle of b lies in cell (0, 0).
void PoseSearch::DrawB(int heading, ComplexGrid& walls, ComplexGrid& behind_and_open) const {
  std::fill(walls.cells.begin(), walls.cells.end(), 0);
  std::fill(behind_and_open.cells.begin(), behind_and_open.cells.end(), 0);
  const Vector2d x_axis = UnitVector(HeadingOf(heading));
  const Vector2d doubled = Doubled(x_axis);
  const Vector2d middle_m = b_.box.Middle();
  const auto place = [&](const Vector2d& point_m) -> Vector2d {
    const Vector2d p = (point_m - middle_m) / cell_m_;
    return {x_axis.x() * p.x() - x_axis.y() * p.y(), x_axis.y() * p.x() + x_axis.x() * p.y()};
  };
  for (const Mark& mark : b_.walls) {
    const Complex direction(
        static_cast<float>(mark.doubled.x() * doubled.x() - mark.doubled.y() * doubled.y()),
        static_cast<float>(mark.doubled.x() * doubled.y() + mark.doubled.y() * doubled.x()));
    cells_.Share(place(mark.point_m),
                 [&](size_t k, float share) { walls.cells[k] += share * direction; });
  }
  for (const Mark& mark : b_.behind) {
    const auto length_m = static_cast<float>(mark.amount);
    cells_.Share(place(mark.point_m),
                 [&](size_t k, float share) { behind_and_open.cells[k] += share * length_m; });
  }
  for (const Mark& mark : b_.open) {
    const auto share_of_cell = static_cast<float>(mark.amount / (cell_m_ * cell_m_));
    cells_.Share(place(mark.point_m), [&](size_t k, float share) {
      behind_and_open.cells[k] += Complex(0, share * share_of_cell);
    });
  }
}

void PoseSearch::Correlate(int heading) {
  for (int n = 0; n < kAtOnce; ++n) {
    DrawB(heading + n, walls_b_[n], behind_and_open_b_[n]);
    fft_.Forward(walls_b_[n]);
    fft_.Forward(behind_and_open_b_[n]);
  }
  constexpr Complex kImaginary(0, 1);
  for (int v = 0; v < height_; ++v) {
    for (int u = 0; u < width_; ++u) {
      // What is real in space has conjugates at the frequencies k and m.
      const size_t k = size_t{1} * v * width_ + u;
      const size_t m = size_t{1} * (v == 0 ? 0 : height_ - v) * width_ + (u == 0 ? 0 : width_ - u);
      std::array<Complex, kAtOnce> scores;
      for (int n = 0; n < kAtOnce; ++n) {
        const std::vector<Complex>& a = walls_a_.cells;
        const std::vector<Complex>& b = walls_b_[n].cells;
        const Complex& z_k = behind_and_open_b_[n].cells[k];
        const Complex z_m = std::conj(behind_and_open_b_[n].cells[m]);
        // The real part of the correlation of directions, and those of the real and the imaginary
        // part of z.
        const Complex agree = (std::conj(b[k]) * a[k] + b[m] * std::conj(a[m])) / 2.0F;
        const Complex behind_b = (z_k + z_m) / 2.0F;
        const Complex open_b = (z_k - z_m) / (2.0F * kImaginary);
        scores[n] = agree - kContradictionWeight * (std::conj(behind_b) * open_a_.cells[k] +
                                                    std::conj(open_b) * behind_a_.cells[k]);
      }
      product_.cells[k] = scores[0] + kImaginary * scores[1];
    }
  }
  fft_.Inverse(product_);
}

// Greater than what is beside, and in doubt than what comes later.
void PoseSearch::AddPeaks(int heading) {
  const float scale = 1 / static_cast<float>(scores_.size());
  for (int y = 0; y < height_; ++y) {
    for (int x = 0; x < width_; ++x) {
      const float score = scores_[size_t{1} * y * width_ + x];
      if (score * scale <= least_m_) continue;
      if (score < scores_[cells_.Index(x + 1, y)] || score <= scores_[cells_.Index(x - 1, y)] ||
          score < scores_[cells_.Index(x, y + 1)] || score <= scores_[cells_.Index(x, y - 1)]) {
        continue;
      }
      peaks_.push_back({score * scale, heading, x, y});
    }
  }
}

void PoseSearch::KeepBestPeaks(size_t most) {
  if (peaks_.size() <= most) return;
  std::nth_element(peaks_.begin(), peaks_.begin() + static_cast<ptrdiff_t>(most), peaks_.end());
  least_m_ = peaks_[most].score_m;
  peaks_.resize(most);
}

Pose2 PoseSearch::PoseOf(const Peak& peak) const {
  // The middle of b is at most its radius outside of a.
  const Vector2d most = CellsInA(a_.box.high_m).array() + radius_m_ / cell_m_ + 2;
  const Vector2d cells(peak.x > most.x() ? peak.x - width_ : peak.x,
                       peak.y > most.y() ? peak.y - height_ : peak.y);
  const Pose2 a_T_middle{a_.box.low_m + cell_m_ * cells, WrapAngle(HeadingOf(peak.heading))};
  return a_T_middle * Pose2{-b_.box.Middle(), 0};
}

std::vector<Pose2> PoseSearch::Run(const std::function<void(double share)>& on_progress) {
  constexpr size_t kKept = 4 * kMostPoses;  // several belong to one place
  for (int heading = 0; heading < headings_; heading += kAtOnce) {
    on_progress(static_cast<double>(heading) / headings_);
    Correlate(heading);
    for (size_t k = 0; k < scores_.size(); ++k) scores_[k] = product_.cells[k].real();
    AddPeaks(heading);
    for (size_t k = 0; k < scores_.size(); ++k) scores_[k] = product_.cells[k].imag();
    AddPeaks(heading + 1);
    if (peaks_.size() > 4 * kKept) KeepBestPeaks(kKept);
  }
  KeepBestPeaks(kKept);
  std::sort(peaks_.begin(), peaks_.end());
  std::vector<Peak> places;
  std::vector<Pose2> poses;
  for (const Peak& peak : peaks_) {
    if (poses.size() == kMostPoses) break;
    const bool is_taken = std::any_of(places.begin(), places.end(), [&](const Peak& place) {
      return CyclicCells::Apart(peak.heading, place.heading, headings_) <= 1 &&
             cells_.AreNeighbours(peak.x, peak.y, place.x, place.y);
    });
    if (is_taken) continue;
    places.push_back(peak);
    poses.push_back(PoseOf(peak));
  }
  return poses;
}

double RadiusOf(const MarkedMap& map) {
  double radius_m = 0;
  for (const std::vector<Mark>* marks : {&map.walls, &map.behind, &map.open}) {
    for (const Mark& mark : *marks) {
      radius_m = std::max(radius_m, (mark.point_m - map.box.Middle()).norm());
    }
  }
  return radius_m;
}

}  // namespace

absl::StatusOr<std::vector<Pose2>> SearchPoses(
    const MapPair& pair, const std::function<void(double share)>& on_progress) {
  const Box box_a = BoxOfWalls(pair.a);
  const Box box_b = BoxOfWalls(pair.b);
  Vector2d room_m = box_a.high_m - box_a.low_m + box_b.high_m - box_b.low_m;
  for (const double cell_knots : kCells) {
    const double cell_m = cell_knots * pair.scale.knot_m;
    // Before there is anything in memory for each cell.
    if (room_m.maxCoeff() > kMostCells * cell_m) continue;
    MarkedMap a = MarkedMapOf(pair.a, box_a, pair.scale, cell_m);
    MarkedMap b = MarkedMapOf(pair.b, box_b, pair.scale, cell_m);
    const double radius_m = RadiusOf(b);
    room_m = a.box.high_m - a.box.low_m + Vector2d::Constant(2 * radius_m);
    const int width = GridFft::SizeFor(static_cast<int>(room_m.x() / cell_m) + 4);
    const int height = GridFft::SizeFor(static_cast<int>(room_m.y() / cell_m) + 4);
    if (std::max(width, height) > kMostCells) continue;
    return PoseSearch(std::move(a), std::move(b), cell_m, radius_m, width, height).Run(on_progress);
  }
  return FailedPrecondition(
      "the maps are too large to be aligned, {:.0f} x {:.0f} m side by side; keep parts of them "
      "with splinemap crop",
      room_m.x(), room_m.y());
}

}  // namespace splinemap
