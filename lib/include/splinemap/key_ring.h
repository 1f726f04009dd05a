#pragma once

#include <array>
#include <cstdint>
#include <map>
#include <memory>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "absl/types/span.h"

namespace splinemap {

// Ed25519, RFC 8032.
using PublicKey = std::array<uint8_t, 32>;
using SecretKey = std::array<uint8_t, 32>;  // the seed that RFC 8032 calls the private key

// A key that is trusted, and with what. Any of them may follow layers.
struct TrustedKey {
  std::string name;  // of who has it, for people
  PublicKey key{};
  std::vector<std::string> maps;  // layers that it may own; patterns with * ? [..]
  bool answers = false;           // for owners that are silent
  bool decides = false;           // commands, and settings of layers

  bool Maps(const std::string& layer) const;
  bool operator==(const TrustedKey&) const = default;
};

// The secret key of this computer, with which it signs what it publishes, and the keys that it
// trusts: with one, a daemon, replica or client believes nothing else on the bus.
// lcmtypes/FOLLOWING.md describes signatures. Immutable.
class KeyRing {
 public:
  // A folder that `splinemap keys` made. NotFound, FailedPrecondition where others can read the
  // secret key, InvalidArgument, each with what to do.
  static absl::StatusOr<std::shared_ptr<const KeyRing>> Read(const std::string& folder);
  // InvalidArgument where two keys begin with the same 8 bytes.
  static absl::StatusOr<std::shared_ptr<const KeyRing>> Make(const SecretKey& secret,
                                                             std::vector<TrustedKey> trusted);

  // The key of this computer, with nothing that it may do where it is not among those trusted.
  const TrustedKey& own() const { return own_; }
  const std::map<uint64_t, TrustedKey>& trusted() const { return trusted_; }

  // Appends the signature of a message that is published on `channel`.
  void Sign(const std::string& channel, std::vector<uint8_t>& message) const;
  // Who signed a message of `channel`. Unauthenticated where nobody did, NotFound where the key is
  // not trusted, DataLoss where the signature is not of this message, this channel and that key.
  absl::StatusOr<const TrustedKey*> SignerOf(const std::string& channel,
                                             absl::Span<const uint8_t> message) const;

 private:
  KeyRing() = default;

  std::array<uint8_t, 64> secret_{};  // as libsodium has it
  TrustedKey own_;
  std::map<uint64_t, TrustedKey> trusted_;  // by the first 8 bytes of the key
};

// The message, signed where there are keys.
inline std::vector<uint8_t> Signed(const KeyRing* keys, const std::string& channel,
                                   std::vector<uint8_t> message) {
  if (keys != nullptr) keys->Sign(channel, message);
  return message;
}

}  // namespace splinemap
