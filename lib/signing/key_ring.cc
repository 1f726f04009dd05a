#include "splinemap/key_ring.h"

#include <fnmatch.h>
#include <sodium.h>

#include <algorithm>
#include <utility>

#include "lib/base/status.h"
#include "lib/signing/key_files.h"
#include "lib/wire/message_type.h"

namespace splinemap {
namespace {

constexpr size_t kIdBytes = 8;
static_assert(kSignatureBytes == kIdBytes + crypto_sign_BYTES);
static_assert(sizeof(PublicKey) == crypto_sign_PUBLICKEYBYTES);
static_assert(sizeof(SecretKey) == crypto_sign_SEEDBYTES);

// Begins what is signed, so that no key that is used for something else as well signs a message.
constexpr std::string_view kContext{"splinemap signature 1\0", 22};

uint64_t IdOf(absl::Span<const uint8_t> key) {
  uint64_t id = 0;
  for (const uint8_t byte : key.first(kIdBytes)) id = id << 8 | byte;
  return id;
}

std::vector<uint8_t> WhatIsSigned(const std::string& channel, absl::Span<const uint8_t> message) {
  std::vector<uint8_t> bytes(kContext.size() + channel.size() + 1 + message.size());
  auto to = std::copy(kContext.begin(), kContext.end(), bytes.begin());
  to = std::copy(channel.begin(), channel.end(), to);
  *to++ = 0;
  std::copy(message.begin(), message.end(), to);
  return bytes;
}

}  // namespace

bool TrustedKey::Maps(const std::string& layer) const {
  return std::any_of(maps.begin(), maps.end(), [&](const std::string& pattern) {
    return fnmatch(pattern.c_str(), layer.c_str(), 0) == 0;
  });
}

absl::StatusOr<std::shared_ptr<const KeyRing>> KeyRing::Read(const std::string& folder) {
  SPLINEMAP_ASSIGN_OR_RETURN(const SecretKey secret, ReadSecretKey(folder));
  SPLINEMAP_ASSIGN_OR_RETURN(std::vector<TrustedKey> trusted, ReadTrusted(folder));
  return Make(secret, std::move(trusted));
}

absl::StatusOr<std::shared_ptr<const KeyRing>> KeyRing::Make(const SecretKey& secret,
                                                             std::vector<TrustedKey> trusted) {
  if (sodium_init() < 0) return Unavailable("libsodium cannot be used");
  std::shared_ptr<KeyRing> ring(new KeyRing());
  crypto_sign_seed_keypair(ring->own_.key.data(), ring->secret_.data(), secret.data());
  ring->own_.name = "this computer";
  for (TrustedKey& key : trusted) {
    if (key.key == ring->own_.key) ring->own_ = key;
    const auto [other, is_new] = ring->trusted_.try_emplace(IdOf(key.key), std::move(key));
    if (!is_new) {
      return InvalidArgument("the keys of {} and {} begin with the same 16 digits",
                             other->second.name, key.name);
    }
  }
  return ring;
}

void KeyRing::Sign(const std::string& channel, std::vector<uint8_t>& message) const {
  const std::vector<uint8_t> bytes = WhatIsSigned(channel, message);
  const size_t content_bytes = message.size();
  message.resize(content_bytes + kSignatureBytes);
  uint8_t* const trailer = message.data() + content_bytes;
  std::copy_n(own_.key.begin(), kIdBytes, trailer);
  crypto_sign_detached(trailer + kIdBytes, nullptr, bytes.data(), bytes.size(), secret_.data());
}

absl::StatusOr<const TrustedKey*> KeyRing::SignerOf(const std::string& channel,
                                                    absl::Span<const uint8_t> message) const {
  if (!IsSigned(message)) {
    return absl::UnauthenticatedError(
        "not signed: the sender needs --keys, and its key has to be trusted here");
  }
  const absl::Span<const uint8_t> trailer = message.last(kSignatureBytes);
  const uint64_t id = IdOf(trailer);
  const auto found = trusted_.find(id);
  if (found == trusted_.end()) {
    return NotFound("signed with key {:016x}.., which is not trusted here: splinemap keys trust",
                    id);
  }
  const std::vector<uint8_t> bytes =
      WhatIsSigned(channel, message.first(message.size() - kSignatureBytes));
  const TrustedKey& key = found->second;
  if (crypto_sign_verify_detached(trailer.data() + kIdBytes, bytes.data(), bytes.size(),
                                  key.key.data()) != 0) {
    return absl::DataLossError(
        fmt::format("not signed by {}, whose key it names: forged or damaged", key.name));
  }
  return &key;
}

}  // namespace splinemap
