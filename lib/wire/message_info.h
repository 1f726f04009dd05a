#pragma once

#include <cstdint>
#include <limits>
#include <vector>

#include "absl/types/span.h"
#include "lcmtypes/message_table.h"

namespace splinemap {

// Walks over the fields of a message without decoding them, to see whether its counts add up to its
// size: the generated decoders allocate what the counts claim.
class SizeWalk {
 public:
  explicit SizeWalk(absl::Span<const uint8_t> message) : rest_(message) {}

  void Skip(size_t bytes) {
    fits_ = fits_ && bytes <= rest_.size();
    if (fits_) rest_.remove_prefix(bytes);
  }

  // Of the elements of an array; at most 2^31 - 1.
  size_t Count() {
    const absl::Span<const uint8_t> bytes = rest_;
    Skip(4);
    if (!fits_) return 0;
    const uint32_t count = (uint32_t{bytes[0]} << 24) | (uint32_t{bytes[1]} << 16) |
                           (uint32_t{bytes[2]} << 8) | bytes[3];
    if (count > std::numeric_limits<int32_t>::max()) fits_ = false;
    return count;
  }

  // Its length counts a closing 0, which the generated decoder takes off without looking.
  void String() {
    const size_t length = Count();
    if (length == 0) fits_ = false;
    Skip(length);
  }

  bool fits() const { return fits_; }
  size_t bytes_left() const { return rest_.size(); }

 private:
  absl::Span<const uint8_t> rest_;
  bool fits_ = true;
};

// What lcmtypes/message_table.py makes of an .lcm file.
struct MessageInfo {
  MessageType type;
  const char* name;     // "bot_core.planar_lidar_t"
  int64_t fingerprint;  // of members' names and types, not of the names of struct and package
  void (*walk)(SizeWalk& walk);  // over all fields
};
const std::vector<MessageInfo>& MessageInfos();

}  // namespace splinemap
