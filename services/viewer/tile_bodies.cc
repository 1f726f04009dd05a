#include "services/viewer/tile_bodies.h"

#include <zlib.h>

#include <bit>
#include <stdexcept>

namespace splinemap {
namespace {

static_assert(std::endian::native == std::endian::little);

std::string Deflate(const Tile& tile) {
  constexpr int kRaw = -15;  // the window, negative: no header
  constexpr int kMemory = 8;
  z_stream stream{};
  if (deflateInit2(&stream, Z_BEST_SPEED, Z_DEFLATED, kRaw, kMemory, Z_DEFAULT_STRATEGY) != Z_OK)
    throw std::bad_alloc();
  constexpr size_t kSize = sizeof(tile.control_points);
  std::string bytes(deflateBound(&stream, kSize), '\0');
  stream.next_in = reinterpret_cast<Bytef*>(const_cast<ControlPoint*>(tile.control_points.data()));
  stream.avail_in = kSize;
  stream.next_out = reinterpret_cast<Bytef*>(bytes.data());
  stream.avail_out = static_cast<uInt>(bytes.size());
  deflate(&stream, Z_FINISH);  // cannot fail: the output has room for all of it
  bytes.resize(stream.total_out);
  bytes.shrink_to_fit();
  deflateEnd(&stream);
  return bytes;
}

}  // namespace

const std::string& TileBodies::Of(const std::shared_ptr<const StoredTile>& tile) {
  if (const auto found = by_tile_.find(tile.get()); found != by_tile_.end()) {
    newest_first_.splice(newest_first_.begin(), newest_first_, found->second);
  } else {
    newest_first_.push_front({tile, Deflate(*tile->Get())});
    by_tile_[tile.get()] = newest_first_.begin();
    if (newest_first_.size() > kMaxTiles) {
      by_tile_.erase(newest_first_.back().tile.get());
      newest_first_.pop_back();
    }
  }
  return newest_first_.front().bytes;
}

}  // namespace splinemap
