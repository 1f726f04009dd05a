#include "lib/exchange/csv.h"

#include <iterator>
#include <string>

#include "lib/base/status.h"

namespace splinemap {

absl::Status WriteCsv(const MapView& map, const PixelGrid& grid, NewFile& file) {
  constexpr size_t kBlock = 1 << 16;
  std::string text = "x_m,y_m,log_odds,probability,known\n";
  for (int row = grid.height - 1; row >= 0; --row) {
    const double y_m = grid.CentreY(row);
    for (int column = 0; column < grid.width; ++column) {
      const double x_m = grid.CentreX(column);
      const SurfaceSample sample = map.Evaluate(x_m, y_m);
      fmt::format_to(std::back_inserter(text), "{},{},{:.6f},{:.6f},{}\n", x_m, y_m,
                     sample.log_odds, Probability(sample.log_odds), sample.known ? 1 : 0);
      if (text.size() < kBlock) continue;
      SPLINEMAP_RETURN_IF_ERROR(file.Write(text));
      text.clear();
    }
  }
  return file.Write(text);
}

}  // namespace splinemap
