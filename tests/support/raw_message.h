#pragma once

#include <algorithm>
#include <cstdint>
#include <vector>

namespace splinemap {

// Bytes that LcmBus publishes as they are.
struct RawMessage {
  std::vector<uint8_t> bytes;

  int getEncodedSize() const { return static_cast<int>(bytes.size()); }
  int encode(void* buffer, int offset, int) const {
    std::copy(bytes.begin(), bytes.end(), static_cast<uint8_t*>(buffer) + offset);
    return getEncodedSize();
  }
};

}  // namespace splinemap
