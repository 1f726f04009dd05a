#include "lib/exchange/geotiff.h"

#include <tiffio.h>

#include <array>
#include <cerrno>
#include <cstdarg>
#include <cstdio>
#include <cstring>
#include <limits>
#include <memory>
#include <string>
#include <vector>

#include "lib/base/status.h"

namespace splinemap {
namespace {

// Tags of GeoTIFF and GDAL, which libtiff does not know.
constexpr uint32_t kModelPixelScale = 33550;
constexpr uint32_t kModelTiepoint = 33922;
constexpr uint32_t kGeoKeyDirectory = 34735;
constexpr uint32_t kGdalMetadata = 42112;
constexpr uint32_t kGdalNoData = 42113;

struct TiffCloser {
  void operator()(TIFF* tiff) const { TIFFClose(tiff); }
};
using Tiff = std::unique_ptr<TIFF, TiffCloser>;

// Keeps the first error of libtiff as text, with the system's reason where there is one.
int KeepError(TIFF*, void* text, const char*, const char* format, va_list arguments) {
  std::array<char, 256> line;
  std::vsnprintf(line.data(), line.size(), format, arguments);
  auto& kept = *static_cast<std::string*>(text);
  if (kept.empty() && errno != 0) kept = fmt::format("{}: {}", line.data(), std::strerror(errno));
  if (kept.empty()) kept = line.data();
  return 1;  // nobody else shall print it
}

Tiff Open(const std::string& path, std::string* error) {
  const std::unique_ptr<TIFFOpenOptions, void (*)(TIFFOpenOptions*)> options(TIFFOpenOptionsAlloc(),
                                                                             TIFFOpenOptionsFree);
  TIFFOpenOptionsSetErrorHandlerExtR(options.get(), KeepError, error);
  return Tiff(TIFFOpenExt(path.c_str(), "w", options.get()));
}

void DeclareTags(TIFF* tiff) {
  const auto field = [](uint32_t tag, TIFFDataType type, const char* name) {
    const bool counted = type != TIFF_ASCII;
    const auto count = static_cast<short>(counted ? TIFF_VARIABLE : -1);
    return TIFFFieldInfo{tag,          count, count,   type,
                         FIELD_CUSTOM, 1,     counted, const_cast<char*>(name)};
  };
  const std::array<TIFFFieldInfo, 5> fields = {
      field(kModelPixelScale, TIFF_DOUBLE, "ModelPixelScale"),
      field(kModelTiepoint, TIFF_DOUBLE, "ModelTiepoint"),
      field(kGeoKeyDirectory, TIFF_SHORT, "GeoKeyDirectory"),
      field(kGdalMetadata, TIFF_ASCII, "GDAL_METADATA"),
      field(kGdalNoData, TIFF_ASCII, "GDAL_NODATA")};
  TIFFMergeFieldInfo(tiff, fields.data(), static_cast<uint32_t>(fields.size()));
}

bool SetLayout(TIFF* tiff, const PixelGrid& grid) {
  return TIFFSetField(tiff, TIFFTAG_IMAGEWIDTH, static_cast<uint32_t>(grid.width)) &&
         TIFFSetField(tiff, TIFFTAG_IMAGELENGTH, static_cast<uint32_t>(grid.height)) &&
         TIFFSetField(tiff, TIFFTAG_SAMPLESPERPIXEL, 1) &&
         TIFFSetField(tiff, TIFFTAG_BITSPERSAMPLE, 32) &&
         TIFFSetField(tiff, TIFFTAG_SAMPLEFORMAT, SAMPLEFORMAT_IEEEFP) &&
         TIFFSetField(tiff, TIFFTAG_PHOTOMETRIC, PHOTOMETRIC_MINISBLACK) &&
         TIFFSetField(tiff, TIFFTAG_PLANARCONFIG, PLANARCONFIG_CONTIG) &&
         TIFFSetField(tiff, TIFFTAG_COMPRESSION, COMPRESSION_ADOBE_DEFLATE) &&
         TIFFSetField(tiff, TIFFTAG_ROWSPERSTRIP, TIFFDefaultStripSize(tiff, 0));
}

bool SetPlace(TIFF* tiff, const PixelGrid& grid) {
  const std::array<double, 3> scale = {grid.pixel_m, grid.pixel_m, 0};
  // The upper left corner of pixel (0, 0).
  const std::array<double, 6> tiepoint = {0, 0, 0, grid.left_m, grid.top_m, 0};
  constexpr uint16_t kUserDefined = 32767;
  const std::array<uint16_t, 16> keys = {1,    1, 0, 3,  // directory version, 3 keys follow
                                         1024, 0, 1, kUserDefined,  // model: a local frame
                                         1025, 0, 1, 1,             // a pixel is an area
                                         3076, 0, 1, 9001};         // linear unit: metre
  return TIFFSetField(tiff, kModelPixelScale, static_cast<int>(scale.size()), scale.data()) &&
         TIFFSetField(tiff, kModelTiepoint, static_cast<int>(tiepoint.size()), tiepoint.data()) &&
         TIFFSetField(tiff, kGeoKeyDirectory, static_cast<int>(keys.size()), keys.data()) &&
         TIFFSetField(tiff, kGdalNoData, "nan") &&
         TIFFSetField(tiff, kGdalMetadata,
                      "<GDALMetadata><Item name=\"DESCRIPTION\" sample=\"0\" role=\"description\">"
                      "log-odds of occupied</Item></GDALMetadata>");
}

bool WriteRows(TIFF* tiff, const MapView& map, const PixelGrid& grid) {
  std::vector<float> values(grid.width);
  for (int row = 0; row < grid.height; ++row) {
    const double y_m = grid.CentreY(row);
    for (int column = 0; column < grid.width; ++column) {
      const SurfaceSample sample = map.Evaluate(grid.CentreX(column), y_m);
      values[column] = sample.known ? static_cast<float>(sample.log_odds)
                                    : std::numeric_limits<float>::quiet_NaN();
    }
    if (TIFFWriteScanline(tiff, values.data(), static_cast<uint32_t>(row), 0) != 1) return false;
  }
  return TIFFFlush(tiff) == 1;
}

}  // namespace

absl::Status WriteGeoTiff(const MapView& map, const PixelGrid& grid, NewFile& file) {
  std::string error;
  errno = 0;
  const Tiff tiff = Open(file.temporary_path(), &error);
  if (tiff) DeclareTags(tiff.get());
  if (!tiff || !SetLayout(tiff.get(), grid) || !SetPlace(tiff.get(), grid) ||
      !WriteRows(tiff.get(), map, grid)) {
    return Unavailable("cannot write {}: {}", file.path(), error);
  }
  return absl::OkStatus();
}

}  // namespace splinemap
