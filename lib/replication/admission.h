#pragma once

#include <cstdint>
#include <map>
#include <memory>
#include <optional>
#include <string>

#include "absl/status/status.h"
#include "absl/types/span.h"
#include "lib/replication/replication_message.h"
#include "splinemap/key_ring.h"

namespace splinemap {

// Decides which messages of the bus count: those that can be decoded and, where there are keys,
// that are signed with one that is trusted and may say so. Thread-compatible.
//
// As an owner (the speaker is the nonce of the session) speaks who maps the layer, and as its proxy
// who answers. Everybody else who is trusted may pull, and tell the hash of settings; the settings
// themselves count where the key decides. Anybody may call who is there.
class Admission {
 public:
  // `speaker` is that of this process, whose own messages are left out.
  Admission(std::string channel_prefix, std::shared_ptr<const KeyRing> keys, uint64_t speaker);

  struct Message {
    ReplicationMessage content;
    // What its sender knows of sessions counts, also those of others.
    bool answers = true;
  };
  std::optional<Message> Admit(absl::Span<const uint8_t> bytes);

  // Messages that are damaged or of another type.
  int64_t malformed() const { return malformed_; }
  // Messages that are not believed, by what is wrong (see KeyRing::SignerOf(), and PermissionDenied
  // for what a key may not say), with the newest reason.
  struct Disbelieved {
    int64_t count = 0;
    std::string why;
  };
  const std::map<absl::StatusCode, Disbelieved>& disbelieved() const { return disbelieved_; }
  int64_t believed() const { return believed_; }
  // The greatest counter of a setting by somebody who is trusted and does not decide: what is
  // decided here has to be later.
  uint64_t passed_counter() const { return passed_counter_; }

 private:
  absl::Status CheckSender(ReplicationMessage& message, absl::Span<const uint8_t> bytes,
                           bool& answers);

  const std::string channel_prefix_;
  const std::shared_ptr<const KeyRing> keys_;
  const uint64_t speaker_;
  int64_t malformed_ = 0;
  int64_t believed_ = 0;
  std::map<absl::StatusCode, Disbelieved> disbelieved_;
  uint64_t passed_counter_ = 0;
};

}  // namespace splinemap
