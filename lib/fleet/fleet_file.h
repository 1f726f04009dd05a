#pragma once

#include <cstdint>
#include <optional>
#include <set>
#include <string>
#include <utility>

#include "absl/functional/function_ref.h"
#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "lib/fleet/fleet_store.h"
#include "splinemap/layer.h"

namespace splinemap {

// Copies of robots' map files, in a bucket of their own. They have the scans that layers are made
// of, so that the maps of robots that are away can be corrected, aligned and thinned. A file lies
// there in chunks that are called by their content: of a later copy, those that changed are sent,
// and a reader has one copy or the other, never a mixture.

// Keys of the bucket.
//   layers.NAME.ORIGIN.file                     FileRecord
//   layers.NAME.ORIGIN.chunk.HASH               128 KiB
std::string FileKey(const LayerId& id);

// Waits until so many bytes may be sent; false where the upload is to end.
using FilePace = absl::FunctionRef<bool(int64_t bytes)>;

// Thread-compatible.
class FleetFileUpload {
 public:
  // `files` outlives it.
  FleetFileUpload(FleetStore& files, LayerId id) : files_(files), id_(std::move(id)) {}

  // Brings the file at `path`, which nobody may change meanwhile. What is there already is not sent
  // again, also of an upload that was ended (Cancelled). InvalidArgument for a file of more than
  // 8 GiB.
  absl::Status Bring(const std::string& path, int64_t utime, FilePace pace);

 private:
  absl::Status List();
  absl::Status BringChunks(const std::string& path, int64_t utime, FilePace pace);

  FleetStore& files_;
  const LayerId id_;
  std::optional<std::set<std::string>> there_;  // keys of chunks; nothing where that is not known
};

struct FleetFile {
  int64_t utime = 0;  // when the copy was made, by the clock of the robot
  int64_t bytes = 0;
};
// What there is of a layer. OutOfRange where there is nothing.
absl::StatusOr<FleetFile> FindFleetFile(FleetStore& files, const LayerId& id);

// Writes the copy to `path`, where nothing may stand. DataLoss where a chunk is damaged or gone:
// unless a later copy has just replaced it, the robot brings it again.
absl::Status GetFleetFile(FleetStore& files, const LayerId& id, const std::string& path);

}  // namespace splinemap
