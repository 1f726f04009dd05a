#pragma once

#include <cstdint>

#include "lcmtypes/splinemap/layer_digest_t.hpp"
#include "lcmtypes/splinemap/layer_pull_t.hpp"
#include "lcmtypes/splinemap/layer_ref_t.hpp"
#include "lib/base/clock.h"
#include "lib/wire/message_type.h"
#include "splinemap/layer.h"
#include "splinemap/level_of_detail.h"

namespace splinemap {

// What owners and followers of layers agree on; lcmtypes/FOLLOWING.md describes it.
inline constexpr int32_t kProtocolVersion = 3;
// With a signature, which not all have, within one Ethernet frame.
inline constexpr size_t kMaxMessageBytes = 1400 - kSignatureBytes;

// One session of a layer at one level of detail.
struct LayerRef {
  LayerId id;
  SessionId session;
  LevelOfDetail level_of_detail;

  bool operator==(const LayerRef&) const = default;
};

inline layer_ref_t ToMessage(const LayerRef& ref) {
  layer_ref_t message;
  message.name = ref.id.name;
  message.origin = static_cast<int64_t>(ref.id.origin);
  message.session_number = static_cast<int64_t>(ref.session.number);
  message.session_nonce = static_cast<int64_t>(ref.session.nonce);
  message.level = static_cast<int8_t>(ref.level_of_detail.level);
  message.statistic = static_cast<int8_t>(ref.level_of_detail.statistic);
  return message;
}

inline LayerRef FromMessage(const layer_ref_t& message) {
  return {
      {message.name, static_cast<uint64_t>(message.origin)},
      {static_cast<uint64_t>(message.session_number), static_cast<uint64_t>(message.session_nonce)},
      {message.level, static_cast<Statistic>(message.statistic)}};
}

// A pull of no layer asks who is there: it is answered by the digests of all layers and by what
// daemons say of themselves.
inline layer_pull_t MakeCall(uint64_t speaker) {
  layer_pull_t call{};
  call.speaker = static_cast<int64_t>(speaker);
  return call;
}
inline bool IsCall(const layer_pull_t& pull) { return pull.layer.name.empty(); }

// Whether the layer's owner speaks, not a proxy.
inline bool IsOwners(const layer_digest_t& digest) {
  return digest.speaker == digest.layer.session_nonce;
}

}  // namespace splinemap
