#include "lib/signing/key_files.h"

#include <fcntl.h>
#include <sodium.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <filesystem>
#include <optional>

#include "absl/cleanup/cleanup.h"
#include "absl/strings/escaping.h"
#include "absl/strings/str_split.h"
#include "absl/strings/strip.h"
#include "lib/base/file.h"
#include "lib/base/plain_text.h"
#include "lib/base/status.h"

namespace splinemap {
namespace {

constexpr std::string_view kSecretHeader = "# The secret key of this computer: no other needs it\n";
constexpr const char* kTrustedHeader =
    "# NAME KEY [maps=PATTERN].. [answers] [decides], the same file on all computers. To trust a\n"
    "# key no longer, delete its line and start the daemons again.\n";

std::string SecretPath(const std::string& folder) { return folder + "/own.key"; }

absl::Status Cannot(const char* what, const std::string& path, int error) {
  return FailedPrecondition("cannot {} {}: {}", what, path, std::strerror(error));
}

// Without spaces, since they separate the words of a line.
bool IsWord(std::string_view text) {
  return !text.empty() && text.front() != '#' &&
         std::all_of(text.begin(), text.end(), [](unsigned char c) { return c > ' ' && c < 0x7f; });
}

absl::StatusOr<TrustedKey> ParseTrusted(std::string_view line) {
  const std::vector<std::string> words =
      absl::StrSplit(std::string(line), absl::ByAnyChar(" \t\r"), absl::SkipEmpty());
  if (words.size() < 2) return InvalidArgument("a name and a key are needed");
  TrustedKey key;
  key.name = words[0];
  SPLINEMAP_ASSIGN_OR_RETURN(key.key, ParseKey(words[1]));
  for (size_t k = 2; k < words.size(); ++k) {
    const std::string& word = words[k];
    constexpr size_t kMapsLength = 5;
    if (word == "answers") {
      key.answers = true;
    } else if (word == "decides") {
      key.decides = true;
    } else if (word.starts_with("maps=") && word.size() > kMapsLength) {
      key.maps.push_back(word.substr(kMapsLength));
    } else {
      return InvalidArgument("{} is none of maps=PATTERN, answers and decides", PlainText(word));
    }
  }
  return key;
}

}  // namespace

std::string TrustedPath(const std::string& folder) { return folder + "/trusted"; }

absl::StatusOr<PublicKey> MakeSecretKey(const std::string& folder) {
  if (sodium_init() < 0) return Unavailable("libsodium cannot be used");
  constexpr mode_t kOwnFolder = 0700;
  constexpr mode_t kOwnFile = 0600;
  if (mkdir(folder.c_str(), kOwnFolder) != 0 && errno != EEXIST) {
    return Cannot("make", folder, errno);
  }
  const std::string path = SecretPath(folder);
  const int file = open(path.c_str(), O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC, kOwnFile);
  if (file < 0 && errno == EEXIST) {
    return absl::AlreadyExistsError(
        path +
        " is there already, and whoever trusts it would not trust another one; splinemap "
        "keys show prints its public key");
  }
  if (file < 0) return Cannot("make", path, errno);
  SecretKey secret;
  randombytes_buf(secret.data(), secret.size());
  std::string text = std::string(kSecretHeader) + KeyText(secret) + "\n";
  const absl::Cleanup wipe = [&] {
    sodium_memzero(secret.data(), secret.size());
    sodium_memzero(text.data(), text.size());
  };
  const bool is_written =
      write(file, text.data(), text.size()) == std::ssize(text) && fsync(file) == 0;
  const int error = errno;
  close(file);
  if (!is_written) {
    unlink(path.c_str());
    return Cannot("write", path, error);
  }
  return PublicKeyOf(secret);
}

absl::StatusOr<SecretKey> ReadSecretKey(const std::string& folder) {
  const std::string path = SecretPath(folder);
  struct stat status {};
  if (stat(path.c_str(), &status) != 0 && errno == ENOENT) {
    return NotFound("there is no key in {}: splinemap keys new {} makes one", folder, folder);
  }
  constexpr mode_t kOthers = 077;
  if ((status.st_mode & kOthers) != 0) {
    return FailedPrecondition("others can read the secret key: chmod 600 {}", path);
  }
  SPLINEMAP_ASSIGN_OR_RETURN(std::string text, ReadFile(path));
  const absl::Cleanup wipe = [&] { sodium_memzero(text.data(), text.size()); };
  std::optional<SecretKey> secret;
  for (const absl::string_view line : absl::StrSplit(text, '\n', absl::SkipWhitespace())) {
    if (line.front() == '#') continue;
    const auto key = ParseKey({line.data(), line.size()});
    if (!key.ok() || secret) return InvalidArgument("{} is no secret key of splinemap", path);
    secret = *key;
  }
  if (!secret) return InvalidArgument("{} is no secret key of splinemap", path);
  return *secret;
}

PublicKey PublicKeyOf(const SecretKey& secret) {
  PublicKey key;
  std::array<uint8_t, crypto_sign_SECRETKEYBYTES> expanded;
  crypto_sign_seed_keypair(key.data(), expanded.data(), secret.data());
  sodium_memzero(expanded.data(), expanded.size());
  return key;
}

absl::StatusOr<std::vector<TrustedKey>> ReadTrusted(const std::string& folder) {
  std::vector<TrustedKey> trusted;
  const std::string path = TrustedPath(folder);
  if (!std::filesystem::exists(path)) return trusted;
  SPLINEMAP_ASSIGN_OR_RETURN(const std::string text, ReadFile(path));
  int number = 0;
  for (absl::string_view line : absl::StrSplit(text, '\n')) {
    ++number;
    line = absl::StripAsciiWhitespace(line);
    if (line.empty() || line.front() == '#') continue;
    const auto key = ParseTrusted({line.data(), line.size()});
    if (!key.ok()) return InvalidArgument("{}:{}: {}", path, number, ErrorText(key.status()));
    for (const TrustedKey& other : trusted) {
      if (other.key != key->key && other.name != key->name) continue;
      return InvalidArgument("{}:{}: {} is there already", path, number,
                             other.name == key->name ? key->name : "the key of " + other.name);
    }
    trusted.push_back(*key);
  }
  return trusted;
}

absl::Status Trust(const std::string& folder, const TrustedKey& key) {
  if (!IsWord(key.name)) {
    return InvalidArgument("\"{}\" is no name of a key: letters, digits and signs without spaces",
                           PlainText(key.name));
  }
  for (const std::string& pattern : key.maps) {
    if (!IsWord(pattern)) {
      return InvalidArgument(
          "\"{}\" is no pattern here: use ? for spaces and other letters than "
          "those of ASCII",
          PlainText(pattern));
    }
  }
  SPLINEMAP_ASSIGN_OR_RETURN(std::vector<TrustedKey> trusted, ReadTrusted(folder));
  std::erase_if(trusted, [&](const TrustedKey& other) {
    return other.name == key.name || other.key == key.key;
  });
  trusted.push_back(key);
  std::string text = kTrustedHeader;
  for (const TrustedKey& each : trusted) text += TrustedLine(each) + "\n";
  return WriteFile(TrustedPath(folder), text);
}

std::string TrustedLine(const TrustedKey& key) {
  std::string line = key.name + " " + KeyText(key.key);
  for (const std::string& pattern : key.maps) line += " maps=" + pattern;
  if (key.answers) line += " answers";
  if (key.decides) line += " decides";
  return line;
}

std::string KeyText(const PublicKey& key) {
  return absl::BytesToHexString({reinterpret_cast<const char*>(key.data()), key.size()});
}

absl::StatusOr<PublicKey> ParseKey(std::string_view text) {
  PublicKey key;
  const bool is_hex = std::all_of(text.begin(), text.end(), [](unsigned char c) {
    return (c >= '0' && c <= '9') || (c >= 'a' && c <= 'f') || (c >= 'A' && c <= 'F');
  });
  if (!is_hex || text.size() != 2 * key.size()) {
    return InvalidArgument("\"{}\" is no key: 64 hexadecimal digits",
                           PlainText(std::string(text.substr(0, 80))));
  }
  const std::string bytes = absl::HexStringToBytes({text.data(), text.size()});
  std::copy(bytes.begin(), bytes.end(), key.begin());
  return key;
}

}  // namespace splinemap
