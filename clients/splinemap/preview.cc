#include "clients/splinemap/preview.h"

#include <sys/ioctl.h>
#include <unistd.h>

#include <algorithm>
#include <cstdlib>
#include <string_view>

#include "lib/base/status.h"
#include "lib/render/raster.h"
#include "lib/render/terminal.h"

namespace splinemap {

absl::StatusOr<std::string> Preview(const MapView& map, int other_rows) {
  const double pixels_per_knot = std::min(1.0, FittingPixelsPerKnot(map, 2000));
  SPLINEMAP_ASSIGN_OR_RETURN(const PixelGrid grid, FittingGrid(map, pixels_per_knot));
  winsize size{};
  const bool is_terminal = isatty(STDOUT_FILENO) == 1;
  if (!is_terminal || ioctl(STDOUT_FILENO, TIOCGWINSZ, &size) != 0 || size.ws_col == 0) {
    size.ws_col = 80;
    size.ws_row = 40;
  }
  const char* terminal = std::getenv("TERM");
  const bool colour = is_terminal && terminal != nullptr && std::string_view(terminal) != "dumb";
  constexpr int kMaxColumns = 120;
  return DrawInTerminal(RenderMap(map, grid), std::min<int>(size.ws_col, kMaxColumns),
                        std::max(size.ws_row - other_rows, 10), colour);
}

}  // namespace splinemap
