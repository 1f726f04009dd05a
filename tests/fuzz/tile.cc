// The content of a tile, as it stands in a file.

#include "lib/map/tile_update.h"
#include "tests/fuzz/fuzz.h"

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  const std::string content(data, data + size);
  const absl::StatusOr<splinemap::Tile> tile = splinemap::DecodeTile(content);
  if (tile.ok()) {
    splinemap::Require(*splinemap::DecodeTile(splinemap::EncodeTile(*tile)) == *tile,
                       "a tile that is encoded again is the same");
  }
  return 0;
}
