#include "lib/fleet/sum_block.h"

#include "absl/strings/numbers.h"
#include "absl/strings/str_split.h"
#include "fmt/format.h"

namespace splinemap {

std::string SumKey(BlockKey block) {
  return fmt::format("sum.{:02}.{}.{}", PartOf(block), block.x, block.y);
}

std::string SumFilter(int part) { return fmt::format("sum.{:02}.>", part); }

std::optional<BlockKey> ParseSumKey(std::string_view key) {
  const std::vector<std::string> tokens = absl::StrSplit(std::string(key), '.');
  BlockKey block;
  if (tokens.size() != 4 || !absl::SimpleAtoi(tokens[2], &block.x) ||
      !absl::SimpleAtoi(tokens[3], &block.y) || !block.IsInRange() || SumKey(block) != key) {
    return std::nullopt;
  }
  return block;
}

LayerBlock SumBlockOf(const TileTree& tiles, BlockKey key) {
  LayerBlock block = BlockOf(tiles, key);
  for (LayerBlock::Entry& entry : block.tiles) entry.revision = 0;
  return block;
}

}  // namespace splinemap
