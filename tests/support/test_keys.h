#pragma once

#include <cstdint>
#include <memory>
#include <vector>

#include "lib/replication/replication_message.h"
#include "lib/signing/key_files.h"
#include "splinemap/key_ring.h"

namespace splinemap {

// Of tests alone: anybody can guess it.
inline SecretKey TestSecret(int number) {
  SecretKey secret;
  secret.fill(static_cast<uint8_t>(number + 1));
  return secret;
}

// As it goes over a bus with the default prefix; unsigned where `keys` is null.
inline std::vector<uint8_t> SignedMessage(const KeyRing* keys, const ReplicationMessage& message) {
  return Signed(keys, ChannelOf(message, "SPLINEMAP"), EncodeReplication(message));
}

}  // namespace splinemap
