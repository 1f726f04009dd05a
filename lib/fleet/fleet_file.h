#pragma once

#include <cstdint>
#include <map>
#include <string>
#include <vector>

#include "absl/functional/function_ref.h"
#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "lib/fleet/fleet_store.h"
#include "splinemap/layer.h"

namespace splinemap {

// Copies of robots' map files, in a bucket of their own. They have the scans that layers are made
// of, so that the maps of robots that are away can be corrected, aligned and thinned. A file lies
// there in chunks, each of which has two keys: a chunk that changed goes to the one that the
// present record does not name. So a reader has one copy or the other, never a mixture, and what
// did not change is not sent again.

// Keys of the bucket.
//   layers.NAME.ORIGIN.file                     FileRecord
//   layers.NAME.ORIGIN.chunk.NUMBER.SLOT        128 KiB
std::string FileKey(const LayerId& id);

// Brings one copy. Thread-compatible.
class FleetFileUpload {
 public:
  // Waits until so many bytes may be sent; false where the upload is to end.
  using Pace = absl::FunctionRef<bool(int64_t bytes)>;

  // Of the file at `path`, which nobody may change meanwhile. `files` outlives it.
  FleetFileUpload(FleetStore& files, LayerId id, std::string path, int64_t utime);

  // Goes on where it was. OK when the copy is whole there; after Cancelled, by `pace`, and
  // Unavailable call it again. InvalidArgument for a file of more than 5.8 GB.
  absl::Status Bring(Pace pace);

 private:
  absl::Status Begin();
  absl::Status BringChunk(const std::string& chunk, Pace pace);

  FleetStore& files_;
  const LayerId id_;
  const std::string path_;
  const int64_t utime_;
  bool has_begun_ = false;
  std::map<std::string, uint64_t> there_;  // hashes of the entries of chunks
  std::string slots_there_;                // of the record that is there
  std::vector<std::string> chunks_;        // hashes of those that were brought
  std::string slots_;                      // the same
  uint64_t bytes_ = 0;                     // the same
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
