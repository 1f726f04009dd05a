#include "lib/layers/validity.h"

#include <algorithm>
#include <string>

#include "lib/base/status.h"

namespace splinemap {
namespace {

constexpr double kMinKnotInterval_m = 0.001;
constexpr double kMaxKnotInterval_m = 10'000;
constexpr size_t kMaxNameBytes = 256;

}  // namespace

absl::Status CheckMapOptions(const MapOptions& options) {
  // Also false for NaN.
  if (!(options.knot_interval_m >= kMinKnotInterval_m &&
        options.knot_interval_m <= kMaxKnotInterval_m)) {
    return InvalidArgument("a knot interval of {} m; {} to {} m can be", options.knot_interval_m,
                           kMinKnotInterval_m, kMaxKnotInterval_m);
  }
  if (options.limits.min >= 0 || options.limits.max <= 0) {
    return InvalidArgument("control points from {} to {}; 0 has to be between", options.limits.min,
                           options.limits.max);
  }
  return absl::OkStatus();
}

absl::Status CheckLayerId(const LayerId& id) {
  if (id.name.empty() || id.name.size() > kMaxNameBytes ||
      id.name.find('\0') != std::string::npos) {
    return InvalidArgument("a name that is empty, longer than {} bytes or not text", kMaxNameBytes);
  }
  return absl::OkStatus();
}

absl::Status CheckSessionId(const SessionId& session) {
  if (session.number <= SessionId::kMaxNumber) return absl::OkStatus();
  return InvalidArgument("start {}; {} is the last that can be", session.number,
                         SessionId::kMaxNumber);
}

absl::Status CheckRevision(uint64_t revision) {
  if (revision <= kMaxRevision) return absl::OkStatus();
  return InvalidArgument("commit {}; {} is the last that can be", revision, kMaxRevision);
}

absl::Status CheckTile(TileKey key, const Tile& tile, ControlLimits limits) {
  if (!IsInRange(key)) return InvalidArgument("tile ({}, {}) is nowhere", key.tx, key.ty);
  const auto [least, greatest] =
      std::minmax_element(tile.control_points.begin(), tile.control_points.end());
  if (*least >= limits.min && *greatest <= limits.max) return absl::OkStatus();
  return InvalidArgument("tile ({}, {}) has control points beyond the clamps", key.tx, key.ty);
}

}  // namespace splinemap
