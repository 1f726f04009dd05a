#pragma once

#include <chrono>
#include <cstdint>

#include "lcmtypes/splinemap/layer_epoch_t.hpp"
#include "lib/base/clock.h"
#include "lib/map/detail.h"
#include "lib/map/layer.h"

namespace splinemap {

// What owners and followers of layers agree on; lcmtypes/README.md describes it in words.
inline constexpr int32_t kProtocolVersion = 1;
inline constexpr size_t kMaxMessageBytes = 1400;  // one Ethernet frame

// A layer in one life of its owner, at one level of detail.
struct LayerLife {
  LayerId id;
  LayerEpoch epoch;
  Detail detail;

  bool operator==(const LayerLife&) const = default;
};

inline layer_epoch_t ToMessage(const LayerLife& life) {
  layer_epoch_t message;
  message.name = life.id.name;
  message.origin = static_cast<int64_t>(life.id.origin);
  message.incarnation = static_cast<int64_t>(life.epoch.incarnation);
  message.nonce = static_cast<int64_t>(life.epoch.nonce);
  message.detail_level = static_cast<int8_t>(life.detail.level);
  message.band = static_cast<int8_t>(life.detail.band);
  return message;
}

inline LayerLife FromMessage(const layer_epoch_t& message) {
  return {{message.name, static_cast<uint64_t>(message.origin)},
          {static_cast<uint64_t>(message.incarnation), static_cast<uint64_t>(message.nonce)},
          {message.detail_level, static_cast<Band>(message.band)}};
}

}  // namespace splinemap
