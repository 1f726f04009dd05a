#include "splinemap/key_ring.h"

#include <gtest/gtest.h>
#include <sys/stat.h>

#include <filesystem>

#include "absl/strings/escaping.h"
#include "lcmtypes/bot_core/pose_t.hpp"
#include "lcmtypes/splinemap/layer_digest_t.hpp"
#include "lcmtypes/splinemap/layer_pull_t.hpp"
#include "lib/base/file.h"
#include "lib/base/status.h"
#include "lib/signing/key_files.h"
#include "lib/wire/decode.h"
#include "lib/wire/encode.h"
#include "tests/support/temporary_directory.h"
#include "tests/support/test_keys.h"

namespace splinemap::key_ring_test {

using Bytes = std::vector<uint8_t>;

constexpr const char* kChannel = "SPLINEMAP_PULLS";

// That of the example in lcmtypes/FOLLOWING.md.
layer_pull_t Pull() {
  layer_pull_t pull{};
  pull.speaker = 7;
  pull.layer.name = "robot";
  pull.layer.origin = 0x1122334455667788;
  pull.layer.session_number = 3;
  pull.layer.session_nonce = static_cast<int64_t>(0x99aabbccddeeff00);
  pull.num_nodes = 4;
  pull.levels = {2, 2, 2, 2};
  pull.xs = {-1, 0, -1, 0};
  pull.ys = {-1, -1, 0, 0};
  return pull;
}

std::shared_ptr<const KeyRing> Ring(int own, std::vector<TrustedKey> trusted) {
  return *KeyRing::Make(TestSecret(own), std::move(trusted));
}
TrustedKey Key(int number) {
  return {fmt::format("robot-{}", number), PublicKeyOf(TestSecret(number)), {}, false, false};
}
Bytes SignedBy(int number) { return Signed(Ring(number, {}).get(), kChannel, Encode(Pull())); }

TEST(KeyRingTest, WhoIsTrustedIsBelieved) {
  const Bytes message = SignedBy(1);
  const auto ring = Ring(2, {Key(1), Key(3)});
  const auto signer = ring->SignerOf(kChannel, message);
  ASSERT_TRUE(signer.ok()) << signer.status();
  EXPECT_EQ((*signer)->name, "robot-1");
  EXPECT_EQ(message.size(), Encode(Pull()).size() + kSignatureBytes);
  EXPECT_TRUE(absl::IsNotFound(ring->SignerOf(kChannel, SignedBy(4)).status()));
  EXPECT_TRUE(absl::IsUnauthenticated(ring->SignerOf(kChannel, Encode(Pull())).status()));
}

// Made with OpenSSL, of the seed 00 01 .. 1f.
TEST(KeyRingTest, SignaturesAreThoseOfOtherImplementations) {
  SecretKey secret;
  for (size_t k = 0; k < secret.size(); ++k) secret[k] = static_cast<uint8_t>(k);
  EXPECT_EQ(KeyText(PublicKeyOf(secret)),
            "03a107bff3ce10be1d70dd18e74bc09967e4d6309ba50d5f1ddc8664125531b8");
  const Bytes message = Signed((*KeyRing::Make(secret, {})).get(), kChannel, Encode(Pull()));
  const std::string text(message.end() - kSignatureBytes, message.end());
  EXPECT_EQ(absl::BytesToHexString(text),
            "03a107bff3ce10be"
            "a937ae7788fd324c5f616301e60be509185a7b444c88011510f3373c91873d72"
            "a6147f3e80431333fb2d734985f22751061c8256ab6ab26610aef5ef7abe820a");
}

TEST(KeyRingTest, NoByteCanBeChangedOrLeftOut) {
  const Bytes message = SignedBy(1);
  const auto ring = Ring(2, {Key(1)});
  for (size_t k = 0; k < message.size(); ++k) {
    for (const int bit : {0, 7}) {
      Bytes changed = message;
      changed[k] ^= static_cast<uint8_t>(1 << bit);
      EXPECT_FALSE(ring->SignerOf(kChannel, changed).ok()) << "byte " << k;
    }
  }
  for (size_t size = 0; size < message.size(); ++size) {
    EXPECT_FALSE(ring->SignerOf(kChannel, {message.data(), size}).ok()) << size << " bytes";
  }
  Bytes longer = message;
  longer.push_back(0);
  EXPECT_FALSE(ring->SignerOf(kChannel, longer).ok());
}

TEST(KeyRingTest, ASignatureIsOfOneMessageOneChannelAndOneKey) {
  const auto ring = Ring(2, {Key(1), Key(3)});
  const Bytes message = SignedBy(1);
  EXPECT_TRUE(absl::IsDataLoss(ring->SignerOf("SPLINEMAP_DIGESTS", message).status()));
  EXPECT_TRUE(absl::IsDataLoss(ring->SignerOf("OTHER_PULLS", message).status()));
  EXPECT_TRUE(absl::IsDataLoss(ring->SignerOf("", message).status()));
  // In the name of another key.
  Bytes forged = message;
  const Bytes other = SignedBy(3);
  std::copy(other.end() - kSignatureBytes, other.end() - 64, forged.end() - kSignatureBytes);
  EXPECT_TRUE(absl::IsDataLoss(ring->SignerOf(kChannel, forged).status()));
  // A signature of the signed message signs no message.
  const Bytes twice = Signed(Ring(3, {}).get(), kChannel, message);
  EXPECT_FALSE(ring->SignerOf(kChannel, twice).ok());
  EXPECT_FALSE(Decode<layer_pull_t>(twice).ok());
}

// With lcm-gen's decoders, too, which take no notice of what follows.
TEST(KeyRingTest, WhoKnowsNoKeysReadsSignedMessages) {
  const auto decoded = Decode<layer_pull_t>(SignedBy(1));
  ASSERT_TRUE(decoded.ok()) << decoded.status();
  EXPECT_EQ(Encode(*decoded), Encode(Pull()));
  const Bytes message = SignedBy(1);
  layer_pull_t generated;
  EXPECT_GT(generated.decode(message.data(), 0, int(message.size())), 0);
  EXPECT_EQ(Encode(generated), Encode(Pull()));
}

TEST(KeyRingTest, MessagesOfRobotsAreNotSigned) {
  bot_core::pose_t pose{};
  pose.orientation[0] = 1;
  const Bytes message = Signed(Ring(1, {}).get(), "POSE", Encode(pose));
  EXPECT_FALSE(IsSigned(message));
  EXPECT_FALSE(Ring(2, {Key(1)})->SignerOf("POSE", message).ok());
}

TEST(KeyRingTest, PatternsSayWhichLayersAKeyMaps) {
  TrustedKey key = Key(1);
  EXPECT_FALSE(key.Maps("robot-1")) << "the name of a key is for people";
  key.maps = {"robot-1", "spare-*"};
  EXPECT_TRUE(key.Maps("robot-1"));
  EXPECT_TRUE(key.Maps("spare-7"));
  EXPECT_FALSE(key.Maps("robot-10"));
}

TEST(KeyFilesTest, ANewKeyIsForItsUserAloneAndIsNotReplaced) {
  const TemporaryDirectory directory;
  const std::string folder = directory.path() + "/keys";
  const auto key = MakeSecretKey(folder);
  ASSERT_TRUE(key.ok()) << key.status();
  struct stat status {};
  ASSERT_EQ(stat((folder + "/own.key").c_str(), &status), 0);
  EXPECT_EQ(status.st_mode & 0777u, 0600u);
  EXPECT_EQ(PublicKeyOf(*ReadSecretKey(folder)), *key);
  EXPECT_TRUE(absl::IsAlreadyExists(MakeSecretKey(folder).status()));
  EXPECT_EQ(PublicKeyOf(*ReadSecretKey(folder)), *key);
  EXPECT_EQ((*KeyRing::Read(folder))->own().key, *key);
  std::filesystem::permissions(folder + "/own.key", std::filesystem::perms(0640));
  const absl::Status open = KeyRing::Read(folder).status();
  EXPECT_TRUE(absl::IsFailedPrecondition(open));
  EXPECT_NE(open.message().find("chmod 600"), std::string::npos) << open;
  EXPECT_TRUE(absl::IsNotFound(KeyRing::Read(directory.path()).status()));
}

TEST(KeyFilesTest, TrustedKeysAreReadAsTheyWereWritten) {
  const TemporaryDirectory directory;
  const std::string folder = directory.path();
  TrustedKey robot = Key(1);
  robot.maps = {"robot-1", "spare-*"};
  TrustedKey base = Key(2);
  base.name = "base";
  base.answers = true;
  base.decides = true;
  ASSERT_TRUE(Trust(folder, robot).ok());
  ASSERT_TRUE(Trust(folder, base).ok());
  EXPECT_EQ(*ReadTrusted(folder), (std::vector<TrustedKey>{robot, base}));
  // The robot has another computer.
  robot.key = PublicKeyOf(TestSecret(3));
  ASSERT_TRUE(Trust(folder, robot).ok());
  EXPECT_EQ(*ReadTrusted(folder), (std::vector<TrustedKey>{base, robot}));
  TrustedKey odd = Key(4);
  odd.name = "two words";
  EXPECT_TRUE(absl::IsInvalidArgument(Trust(folder, odd)));
  odd.name = "line\nanother";
  EXPECT_TRUE(absl::IsInvalidArgument(Trust(folder, odd)));
  odd.name = "#comment";
  EXPECT_TRUE(absl::IsInvalidArgument(Trust(folder, odd)));
  odd.name = "robot-4";
  odd.maps = {"a decides"};
  EXPECT_TRUE(absl::IsInvalidArgument(Trust(folder, odd)));
}

TEST(KeyFilesTest, ADamagedFileIsRefusedWithTheLine) {
  const TemporaryDirectory directory;
  const std::string folder = directory.path();
  const std::string key = KeyText(PublicKeyOf(TestSecret(1)));
  const std::vector<std::string> lines{
      "robot",
      "robot " + key.substr(1),
      "robot " + key + "0",
      "robot x" + key.substr(1),
      "robot " + key + " maps=",
      "robot " + key + " decide",
      "robot " + key + "\nrobot " + KeyText(PublicKeyOf(TestSecret(2))),
      "robot " + key + "\nother " + key,
      std::string("robot \0", 7) + key};
  for (const std::string& line : lines) {
    ASSERT_TRUE(WriteFile(TrustedPath(folder), "# people\n\n" + line + "\n").ok());
    const absl::Status status = ReadTrusted(folder).status();
    EXPECT_TRUE(absl::IsInvalidArgument(status)) << line;
    EXPECT_NE(status.message().find(line.find('\n') == std::string::npos ? ":3:" : ":4:"),
              std::string::npos)
        << status;
  }
  ASSERT_TRUE(WriteFile(TrustedPath(folder), "\t robot  " + key + " \tdecides\r\n").ok());
  EXPECT_TRUE(ReadTrusted(folder)->at(0).decides);
  for (const char* secret : {"", "# only\n", "0123\n", "x\n"}) {
    ASSERT_TRUE(WriteFile(folder + "/own.key", secret).ok());
    std::filesystem::permissions(folder + "/own.key", std::filesystem::perms(0600));
    EXPECT_TRUE(absl::IsInvalidArgument(KeyRing::Read(folder).status())) << secret;
  }
}

}  // namespace splinemap::key_ring_test
