#pragma once

#include <string>

#include "absl/status/statusor.h"
#include "splinemap/layer_set.h"
#include "splinemap/utime.h"

namespace splinemap {

// What a TIME on the command line may be, for --help.
inline constexpr const char* kTimeHelp =
    "a TIME is end-90s or start+1h30m, of the scans in the map, 2026-11-29T10:00:00 (UTC), or "
    "microseconds since 1970";

// The same for the end of a command's help.
inline constexpr const char* kTimeFooter =
    "\nA TIME is end-90s or start+1h30m, of the scans in the map, 2026-11-29T10:00:00 (UTC), or\n"
    "microseconds since 1970.";

absl::StatusOr<Utime> ParseTime(const std::string& text, const LayerSet& set);

// 2026-11-29T10:00:00.5 in UTC.
std::string TextOf(Utime utime);

}  // namespace splinemap
