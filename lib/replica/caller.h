#pragma once

#include <chrono>
#include <memory>
#include <string>
#include <utility>

#include "lcmtypes/splinemap/layer_pull_t.hpp"
#include "lib/base/clock.h"
#include "lib/base/random.h"
#include "lib/replication/protocol.h"
#include "lib/replication/replication_message.h"
#include "lib/wire/encode.h"
#include "lib/wire/lcm_bus.h"
#include "splinemap/key_ring.h"

namespace splinemap {

// Asks on a bus who is there, for a program that shows what daemons say of themselves: they answer
// within a second, and say little where nothing changes and nobody asks. Thread-compatible.
class Caller {
 public:
  // `bus` outlives it. Where there are keys, it signs what it asks.
  Caller(LcmBus& bus, const std::string& channel_prefix,
         std::shared_ptr<const KeyRing> keys = nullptr)
      : bus_(bus), keys_(std::move(keys)), channel_(ChannelOf(layer_pull_t(), channel_prefix)) {}

  // Call it as often as there may be news to show; it asks once a second.
  void Tick(Clock::time_point now) {
    if (now < next_) return;
    next_ = now + std::chrono::seconds(1);
    bus_.PublishBytes(channel_, Signed(keys_.get(), channel_, Encode(MakeCall(speaker_))));
  }

 private:
  LcmBus& bus_;
  const std::shared_ptr<const KeyRing> keys_;
  const std::string channel_;
  const uint64_t speaker_ = RandomId();
  Clock::time_point next_;
};

}  // namespace splinemap
