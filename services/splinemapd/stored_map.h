#pragma once

#include "absl/status/statusor.h"
#include "lib/config/config.h"
#include "services/splinemapd/notice_log.h"
#include "splinemap/file.h"
#include "splinemap/layer_set.h"
#include "splinemap/scan_archive.h"

namespace splinemap {

// What a daemon begins with.
struct StoredMap {
  MapOptions options;
  Layer own;            // in a new session
  ScanArchive archive;  // of its scans
  LayerSet others;      // and all settings
};

// Loads the map of `file`, or begins an empty one, and starts the next session of the robot's own
// layer, whose nonce are random bits. FailedPrecondition where the configuration asks for other
// options than those of the file. What is corrupt is reported.
absl::StatusOr<StoredMap> LoadStoredMap(const config::Config& config, MapFile& file,
                                        NoticeLog& notices);

}  // namespace splinemap
