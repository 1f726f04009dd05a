#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "splinemap/layer_set.h"

namespace splinemap {

// A valid message of splinemap, for tests to change.
struct ValidMessage {
  std::string type;     // without its package
  std::string channel;  // after the prefix
  std::vector<uint8_t> bytes;
};

// What an owner, a proxy and a follower of a layer say of it, level 0: one of each type at
// least.
std::vector<ValidMessage> MessagesOf(const LayerSnapshot& layer, const MapOptions& options);

// A valid change of two tiles that the owner never made, to control points of one value.
ValidMessage FalseUpdates(const LayerSnapshot& layer, ControlPoint value);

// A valid scan of the next commit that the owner never mapped.
ValidMessage FalseScan(const LayerSnapshot& layer);

// Settings that change nothing, to be changed.
ValidMessage SettingsMessage(const LayerId& id, uint64_t counter);

// A trajectory of a robot that nobody has.
ValidMessage TrajectoryMessage();

// A request of each query.
std::vector<ValidMessage> Queries(int64_t daemon_nonce);

// Commands about a layer, one of each kind.
std::vector<ValidMessage> LayerCommands(const LayerSnapshot& layer, int64_t daemon_nonce);

// A command to a daemon about its own layer.
ValidMessage Command(const std::string& command, uint64_t session_number, int64_t daemon_nonce);

}  // namespace splinemap
