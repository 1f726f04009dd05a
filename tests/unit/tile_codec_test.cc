#include "lib/tiles/tile_codec.h"

#include <gtest/gtest.h>
#include <zstd.h>

#include <random>
#include <vector>

#include "tests/support/random_map.h"

namespace splinemap::tile_codec_test {

TEST(TileCodecTest, RoundTrips) {
  std::mt19937_64 random(1);
  for (int n = 0; n < 200; ++n) {
    const Tile tile = n == 0 ? Tile() : RandomTile(random);
    const TileUpdate update = MakeTileUpdate(RandomKey(random, 1000), tile, 17);
    const absl::StatusOr<Tile> decoded = TileOfUpdate(update);
    ASSERT_TRUE(decoded.ok()) << decoded.status();
    EXPECT_EQ(*decoded, tile);
  }
}

TEST(TileCodecTest, EveryFlippedByteIsNoticed) {
  std::mt19937_64 random(2);
  const TileUpdate update = MakeTileUpdate({1, -2}, RandomTile(random), 1);
  for (size_t k = 0; k < update.content.size(); ++k) {
    TileUpdate damaged = update;
    damaged.content[k] = static_cast<char>(damaged.content[k] ^ 0x10);
    const absl::StatusOr<Tile> decoded = TileOfUpdate(damaged);
    // A flip may leave the content as it was only where zstd does not use the bit.
    if (decoded.ok()) {
      EXPECT_EQ(*decoded, *TileOfUpdate(update)) << k;
    }
  }
  TileUpdate moved = update;
  moved.key.tx = 2;
  EXPECT_EQ(TileOfUpdate(moved).status().code(), absl::StatusCode::kDataLoss);
}

TEST(TileCodecTest, RefusesContentOfAnotherSize) {
  for (const size_t bytes : {size_t{0}, size_t{2047}, size_t{2049}, size_t{100} << 20}) {
    const std::vector<char> raw(bytes);
    std::string content(ZSTD_compressBound(bytes), '\0');
    content.resize(ZSTD_compress(content.data(), content.size(), raw.data(), bytes, 1));
    EXPECT_FALSE(DecodeTile(content).ok()) << bytes;
  }
  EXPECT_FALSE(DecodeTile("").ok());
  EXPECT_FALSE(DecodeTile("no zstd at all").ok());
}

}  // namespace splinemap::tile_codec_test
