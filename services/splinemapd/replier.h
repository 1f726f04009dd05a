#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <string>

#include "absl/types/span.h"
#include "lib/map/map.h"
#include "lib/rpc/messages.h"

namespace splinemap {

// Who replies to clients, and for which map. Thread-safe where its functions are.
struct Replier {
  using TakeSnapshot = std::function<std::shared_ptr<const MapSnapshot>()>;
  using Send = std::function<void(const std::string& channel, absl::Span<const uint8_t> reply)>;

  std::string channel_prefix;
  uint64_t daemon_nonce = 0;   // of this start of the daemon, not 0
  TakeSnapshot take_snapshot;  // the daemon's own layer first
  Send send;

  bool IsForOther(const request_t& request) const;
  // Says how the map is now.
  reply_t HeadFor(const request_t& request) const;
  void Reply(const request_t& request, absl::Span<const uint8_t> reply) const;
};

}  // namespace splinemap
