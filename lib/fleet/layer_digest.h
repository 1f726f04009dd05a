#pragma once

#include <cstdint>
#include <optional>
#include <string>

#include "absl/status/statusor.h"
#include "splinemap/layer_set.h"
#include "splinemap/region.h"

namespace splinemap {

// What a bucket says of a layer as a whole.
struct LayerDigest {
  LayerId id;
  SessionId session;
  uint64_t revision = 0;
  uint64_t tiles = 0;
  uint64_t hash = 0;  // the sum of the checksums of tiles
  int64_t utime = 0;  // clock of the robot
  MapOptions options;
  TileBox box;               // around the tiles
  bool is_arriving = false;  // the first one, without tiles, while they are on their way
};

// A DigestRecord.
std::string EncodeDigest(const LayerDigest& digest);
// DataLoss where the value is damaged or of another layer, InvalidArgument for what cannot be.
absl::StatusOr<LayerDigest> DecodeDigest(const std::string& value, const LayerId& id);
// What it says but for the time, never 0.
uint64_t HashOf(const LayerDigest& digest);

// A MapRecord.
std::string EncodeMapOptions(const MapOptions& options);
absl::StatusOr<MapOptions> DecodeMapOptions(const std::string& value);

// Both, for people.
std::string TextOf(const MapOptions& options);

}  // namespace splinemap
