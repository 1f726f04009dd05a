#pragma once

#include <string>
#include <string_view>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "splinemap/key_ring.h"

namespace splinemap {

// The folder of `--keys`. `own.key` is the secret key of this computer, which its user alone can
// read. `trusted` has a line for each key that is trusted, and is the same on all computers:
//   NAME KEY [maps=PATTERN].. [answers] [decides]
// Errors name the file and what to do.

// Makes the folder where it is not there, and a secret key in it; the public key. AlreadyExists
// where there is one.
absl::StatusOr<PublicKey> MakeSecretKey(const std::string& folder);
absl::StatusOr<SecretKey> ReadSecretKey(const std::string& folder);
PublicKey PublicKeyOf(const SecretKey& secret);

// Empty where there is no file yet.
absl::StatusOr<std::vector<TrustedKey>> ReadTrusted(const std::string& folder);
// Adds a line to `trusted`, in place of those of the same name or key.
absl::Status Trust(const std::string& folder, const TrustedKey& key);
// The line without its end.
std::string TrustedLine(const TrustedKey& key);
std::string TrustedPath(const std::string& folder);

// 64 hexadecimal digits.
std::string KeyText(const PublicKey& key);
absl::StatusOr<PublicKey> ParseKey(std::string_view text);

}  // namespace splinemap
