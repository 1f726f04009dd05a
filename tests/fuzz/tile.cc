// The content of a tile, as it stands in a file.

#include "lib/tiles/tile_codec.h"
#include "tests/fuzz/fuzz.h"

namespace splinemap::fuzz_tile {

void Run(FuzzInput input) {
  const absl::StatusOr<Tile> tile = DecodeTile(input.RestText());
  if (!tile.ok()) return;
  Require(*DecodeTile(EncodeTile(*tile)) == *tile, "a tile that is encoded again is the same");
}

const FuzzTarget target("tile", &Run);

}  // namespace splinemap::fuzz_tile
