#include "lib/exchange/ros_grid.h"

#include <png.h>
#include <yaml-cpp/yaml.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <istream>
#include <limits>
#include <memory>

#include "absl/cleanup/cleanup.h"
#include "lib/base/file.h"
#include "lib/base/status.h"
#include "lib/exchange/ros_map.h"
#include "splinemap/region.h"

namespace splinemap {
namespace {

struct RosYamlFields {
  std::string image;
  RosMode mode = RosMode::kTrinary;
  double resolution_m = 0;
  std::vector<double> origin;  // x, y in m and yaw in rad
  bool negate = false;
  double occupied_thresh = 0;
  double free_thresh = 0;
};

// A field that has to be there; the error names it.
template <typename Value>
absl::Status Take(const YAML::Node& yaml, const char* name, const char* what, Value& value) {
  const YAML::Node node = yaml[name];
  if (!node) return InvalidArgument("the field {} is missing", name);
  if (!YAML::convert<Value>::decode(node, value)) {
    return InvalidArgument("the field {} is not {}", name, what);
  }
  return absl::OkStatus();
}

// 0 and 1, as map_saver writes it, or true and false.
absl::Status TakeNegate(const YAML::Node& yaml, bool& negate) {
  int number = 0;
  if (Take(yaml, "negate", "", number).ok() && (number == 0 || number == 1)) {
    negate = number == 1;
    return absl::OkStatus();
  }
  return Take(yaml, "negate", "0 or 1", negate);
}

absl::Status TakeMode(const YAML::Node& yaml, RosMode& mode) {
  if (!yaml["mode"]) return absl::OkStatus();
  std::string name;
  SPLINEMAP_RETURN_IF_ERROR(Take(yaml, "mode", "trinary, scale or raw", name));
  for (const RosMode known : {RosMode::kTrinary, RosMode::kScale, RosMode::kRaw}) {
    if (name != NameOf(known)) continue;
    mode = known;
    return absl::OkStatus();
  }
  return InvalidArgument("the field mode is {}; it is trinary, scale or raw", name);
}

absl::Status Check(const RosYamlFields& fields) {
  if (!(fields.resolution_m > 0 && std::isfinite(fields.resolution_m))) {
    return InvalidArgument("the resolution is {} m per cell; it has to be positive",
                           fields.resolution_m);
  }
  const auto is_finite = [](double number) { return std::isfinite(number); };
  if (fields.origin.size() != 3 || !std::ranges::all_of(fields.origin, is_finite)) {
    return InvalidArgument("the origin is not [x, y, yaw] in m and rad");
  }
  const double free = fields.free_thresh;
  const double occupied = fields.occupied_thresh;
  if (!(0 <= free && free < occupied && occupied <= 1)) {
    return InvalidArgument(
        "free_thresh is {} and occupied_thresh is {}; they have to rise from 0 to 1", free,
        occupied);
  }
  return absl::OkStatus();
}

absl::StatusOr<RosYamlFields> ParseYaml(const std::string& text) try {
  const YAML::Node yaml = YAML::Load(text);
  if (!yaml.IsMap()) return InvalidArgument("it has no fields such as image and resolution");
  RosYamlFields fields;
  SPLINEMAP_RETURN_IF_ERROR(Take(yaml, "image", "a file name", fields.image));
  SPLINEMAP_RETURN_IF_ERROR(TakeMode(yaml, fields.mode));
  SPLINEMAP_RETURN_IF_ERROR(Take(yaml, "resolution", "a number", fields.resolution_m));
  SPLINEMAP_RETURN_IF_ERROR(Take(yaml, "origin", "[x, y, yaw]", fields.origin));
  SPLINEMAP_RETURN_IF_ERROR(TakeNegate(yaml, fields.negate));
  SPLINEMAP_RETURN_IF_ERROR(Take(yaml, "occupied_thresh", "a number", fields.occupied_thresh));
  SPLINEMAP_RETURN_IF_ERROR(Take(yaml, "free_thresh", "a number", fields.free_thresh));
  SPLINEMAP_RETURN_IF_ERROR(Check(fields));
  return fields;
} catch (const YAML::Exception& error) {
  return InvalidArgument("line {} is no YAML: {}", error.mark.line + 1, error.msg);
}

// The cell of an opaque pixel of brightness `shade`, 0 .. 1.
uint8_t CellOf(const RosYamlFields& fields, double shade) {
  if (fields.mode == RosMode::kRaw) {
    const auto per_cent = std::lround(255 * shade);
    return per_cent <= 100 ? static_cast<uint8_t>(per_cent) : RosGrid::kUnknown;
  }
  const double occupied = fields.negate ? shade : 1 - shade;
  if (occupied > fields.occupied_thresh) return 100;
  if (occupied < fields.free_thresh) return 0;
  if (fields.mode == RosMode::kTrinary) return RosGrid::kUnknown;
  return static_cast<uint8_t>(std::lround(100 * (occupied - fields.free_thresh) /
                                          (fields.occupied_thresh - fields.free_thresh)));
}

// Sets the size of the grid, and its cells to unknown.
absl::Status Resize(double width, double height, RosGrid& grid) {
  if (!(width >= 1 && height >= 1)) return InvalidArgument("{} has no pixels", grid.image_path);
  if (width * height > RosGrid::kMaxCells) {
    return InvalidArgument("{} has {:.0f} x {:.0f} cells; {:.0f} are the most", grid.image_path,
                           width, height, RosGrid::kMaxCells);
  }
  grid.width = static_cast<int>(width);
  grid.height = static_cast<int>(height);
  grid.per_cent.assign(size_t{1} * grid.width * grid.height, RosGrid::kUnknown);
  return absl::OkStatus();
}

// The cell of a pixel; pictures count rows from the top.
uint8_t& CellAt(RosGrid& grid, int column, int row) {
  return grid.per_cent[size_t{1} * (grid.height - 1 - row) * grid.width + column];
}

absl::Status ReadPng(const RosYamlFields& fields, RosGrid& grid) {
  png_image image{};
  image.version = PNG_IMAGE_VERSION;
  const absl::Cleanup free = [&] { png_image_free(&image); };
  const auto damaged = [&] {
    return DataLoss("{} cannot be read: {}", grid.image_path, image.message);
  };
  if (png_image_begin_read_from_file(&image, grid.image_path.c_str()) == 0) return damaged();
  SPLINEMAP_RETURN_IF_ERROR(Resize(image.width, image.height, grid));
  image.format = PNG_FORMAT_RGBA;
  image.flags |= PNG_IMAGE_FLAG_16BIT_sRGB;  // else 16 bits would be taken for linear ones
  std::vector<uint8_t> pixels(PNG_IMAGE_SIZE(image));
  if (png_image_finish_read(&image, nullptr, pixels.data(), 0, nullptr) == 0) return damaged();
  const uint8_t* rgba = pixels.data();
  for (int row = 0; row < grid.height; ++row) {
    for (int column = 0; column < grid.width; ++column, rgba += 4) {
      if (rgba[3] != 255) continue;
      CellAt(grid, column, row) = CellOf(fields, (rgba[0] + rgba[1] + rgba[2]) / (3 * 255.0));
    }
  }
  return absl::OkStatus();
}

// The next number in the head of a PGM, where # begins a comment; 0 where there is none.
int HeadNumber(std::istream& in) {
  while ((in >> std::ws).peek() == '#') {
    in.ignore(std::numeric_limits<std::streamsize>::max(), '\n');
  }
  int number = 0;
  return in >> number ? number : 0;
}

// `in` stands behind the P5.
absl::Status ReadPgm(std::istream& in, const RosYamlFields& fields, RosGrid& grid) {
  const int width = HeadNumber(in);
  const int height = HeadNumber(in);
  const int white = HeadNumber(in);
  in.get();
  const std::istream::pos_type begin = in.tellg();
  const std::streamoff bytes = in.seekg(0, std::ios::end).tellg() - begin;
  if (bytes < int64_t{1} * width * height) {
    return DataLoss("{} is cut off: it has not {} x {} pixels", grid.image_path, width, height);
  }
  in.seekg(begin);
  SPLINEMAP_RETURN_IF_ERROR(Resize(width, height, grid));
  if (white < 1 || white > 255) {
    return InvalidArgument("{} has not 8 bits a pixel: white is {}, not 1 .. 255", grid.image_path,
                           white);
  }
  std::string pixels(grid.width, '\0');
  for (int row = 0; row < grid.height; ++row) {
    in.read(pixels.data(), grid.width);
    for (int column = 0; column < grid.width; ++column) {
      const auto grey = static_cast<uint8_t>(pixels[column]);
      CellAt(grid, column, row) = CellOf(fields, double{1} * std::min<int>(grey, white) / white);
    }
  }
  return absl::OkStatus();
}

absl::Status CheckIsFile(const std::string& path) {
  std::error_code error;
  if (!std::filesystem::exists(path, error)) return NotFound("there is no file {}", path);
  if (!std::filesystem::is_regular_file(path, error)) return InvalidArgument("{} is no file", path);
  return absl::OkStatus();
}

absl::Status ReadImage(const RosYamlFields& fields, RosGrid& grid) {
  SPLINEMAP_RETURN_IF_ERROR(CheckIsFile(grid.image_path));
  std::ifstream in(grid.image_path, std::ios::binary);
  std::string magic(2, '\0');
  in.read(magic.data(), 2);
  if (magic == "P5") return ReadPgm(in, fields, grid);
  if (magic == "\x89P") return ReadPng(fields, grid);
  return InvalidArgument("{} is neither a PNG nor a binary PGM (P5)", grid.image_path);
}

// By per_cent. Known cells are not 0.
std::array<ControlPoint, 256> ControlPointsOf(const CellWeights& weights, ControlLimits limits) {
  std::array<ControlPoint, 256> control_points{};
  for (int per_cent = 0; per_cent <= 100; ++per_cent) {
    const double probability = per_cent / 100.0;
    const double log_odds = std::clamp(std::log(probability / (1 - probability)),
                                       weights.free_log_odds, weights.occupied_log_odds);
    control_points[per_cent] =
        ClampTouched(static_cast<int32_t>(std::lround(kUnitsPerLogOdds * log_odds)), limits);
  }
  return control_points;
}

// The greatest of the cells around control points.
class CellSampler {
 public:
  CellSampler(const RosGrid& grid, std::array<ControlPoint, 256> control_points, double knot_m)
      : grid_(grid), control_points_(control_points) {
    const double cosine = std::cos(grid.map_T_grid.yaw_rad);
    const double sine = std::sin(grid.map_T_grid.yaw_rad);
    cells_T_knots_ << cosine, sine, -sine, cosine;
    cells_T_knots_ *= knot_m / grid.cell_m;
    origin_knots_ = grid.map_T_grid.position_m / knot_m;
    // Two for the smaller of cell and knot interval: at a quarter and three quarters of it, so that
    // none lies between two cells where centres or edges of cells lie on knots.
    const int samples = 2 * std::max(1, static_cast<int>(std::ceil(knot_m / grid.cell_m - 1e-6)));
    for (int k = 0; k < samples * samples; ++k) {
      const Eigen::Vector2d sample(k % samples + 0.5, k / samples + 0.5);
      around_.emplace_back(cells_T_knots_ * (sample.array() / samples - 0.5).matrix());
    }
  }

  ControlPoint GreatestAround(int32_t i, int32_t j) const {
    const Eigen::Vector2d centre = cells_T_knots_ * (Eigen::Vector2d(i, j) - origin_knots_);
    ControlPoint greatest = std::numeric_limits<ControlPoint>::min();
    for (const Eigen::Vector2d& offset : around_) {
      greatest = std::max(greatest, ControlPointOf(centre + offset));
    }
    return greatest;
  }

 private:
  ControlPoint ControlPointOf(const Eigen::Vector2d& cell) const {
    if (!(cell.x() >= 0 && cell.x() < grid_.width)) return 0;
    if (!(cell.y() >= 0 && cell.y() < grid_.height)) return 0;
    const auto row = static_cast<size_t>(cell.y());
    return control_points_[grid_.per_cent[row * grid_.width + static_cast<size_t>(cell.x())]];
  }

  const RosGrid& grid_;
  std::array<ControlPoint, 256> control_points_;
  Eigen::Matrix2d cells_T_knots_;
  Eigen::Vector2d origin_knots_;
  std::vector<Eigen::Vector2d> around_;  // in cells
};

// The tiles that the grid may touch.
absl::StatusOr<TileBox> TilesAround(const RosGrid& grid, double knot_m) {
  constexpr double kMaxCellsPerKnot = 64;
  constexpr double kMaxControlPoints = 1 << 28;
  if (grid.cell_m < knot_m / kMaxCellsPerKnot) {
    return InvalidArgument(
        "the resolution is {} m per cell; {} m are the finest at a knot interval of {} m",
        grid.cell_m, knot_m / kMaxCellsPerKnot, knot_m);
  }
  Eigen::AlignedBox2d box;
  for (const double x_m : {0.0, grid.width * grid.cell_m}) {
    for (const double y_m : {0.0, grid.height * grid.cell_m}) {
      box.extend(grid.map_T_grid * Eigen::Vector2d(x_m, y_m));
    }
  }
  const double limit_m = (kMaxKnotIndex - Tile::kSide) * knot_m;
  if (!(box.min().minCoeff() > -limit_m && box.max().maxCoeff() < limit_m)) {
    return InvalidArgument("the map lies beyond {:.0f} m from the origin, where no map reaches",
                           limit_m);
  }
  if (box.volume() > kMaxControlPoints * knot_m * knot_m) {
    return InvalidArgument(
        "the map spans {:g} x {:g} m, which is too much at a knot interval of {} m: {:g} m2 are "
        "the most. Is the resolution of {} m per cell right?",
        box.sizes().x(), box.sizes().y(), knot_m, kMaxControlPoints * knot_m * knot_m, grid.cell_m);
  }
  return TilesOf({box.min().x(), box.min().y(), box.max().x(), box.max().y()}, knot_m);
}

}  // namespace

absl::StatusOr<RosGrid> ReadRosGrid(const std::string& yaml_path) {
  constexpr size_t kMaxYamlBytes = 1 << 16;
  SPLINEMAP_RETURN_IF_ERROR(CheckIsFile(yaml_path));
  std::error_code ignored;
  if (std::filesystem::file_size(yaml_path, ignored) > kMaxYamlBytes) {
    return InvalidArgument("{} is no .yaml of a map: it is too large", yaml_path);
  }
  SPLINEMAP_ASSIGN_OR_RETURN(const std::string text, ReadFile(yaml_path));
  const absl::StatusOr<RosYamlFields> fields = ParseYaml(text);
  if (!fields.ok()) return InvalidArgument("{}: {}", yaml_path, ErrorText(fields.status()));
  RosGrid grid;
  grid.image_path = (std::filesystem::path(yaml_path).parent_path() / fields->image).string();
  grid.cell_m = fields->resolution_m;
  grid.map_T_grid = {{fields->origin[0], fields->origin[1]}, fields->origin[2]};
  SPLINEMAP_RETURN_IF_ERROR(ReadImage(*fields, grid));
  return grid;
}

absl::StatusOr<TileTree> TilesOf(const RosGrid& grid, const CellWeights& weights,
                                 const MapOptions& options) {
  constexpr uint64_t kRevision = 1;
  SPLINEMAP_ASSIGN_OR_RETURN(const TileBox box, TilesAround(grid, options.knot_interval_m));
  const CellSampler sampler(grid, ControlPointsOf(weights, options.limits),
                            options.knot_interval_m);
  TileTreeEditor tiles;
  for (int32_t ty = box.ty0; ty < box.ty1; ++ty) {
    for (int32_t tx = box.tx0; tx < box.tx1; ++tx) {
      Tile tile;
      for (int k = 0; k < Tile::kSize; ++k) {
        tile.control_points[k] = sampler.GreatestAround(tx * Tile::kSide + k % Tile::kSide,
                                                        ty * Tile::kSide + k / Tile::kSide);
      }
      if (CountTouched(tile) == 0) continue;
      tiles.Put({tx, ty}, std::make_shared<const StoredTile>(tile), kRevision);
    }
  }
  return tiles.Freeze();
}

}  // namespace splinemap
