// Any bytes as a message of the replication protocol, where signatures are asked for and where not.
// What is admitted with keys carries the signature of somebody who is trusted.

#include "lib/replication/admission.h"

#include <memory>
#include <vector>

#include "tests/fuzz/fuzz.h"
#include "tests/support/test_keys.h"

namespace splinemap::fuzz_admission {

void Run(FuzzInput input) {
  static const auto& ring = *new std::shared_ptr<const KeyRing>(*KeyRing::Make(
      TestSecret(1), {{"robot", PublicKeyOf(TestSecret(1)), {"robot"}, true, true}}));
  const absl::Span<const uint8_t> message = input.Rest();
  Admission open("SPLINEMAP", nullptr, 1);
  Admission signed_alone("SPLINEMAP", ring, 1);
  const auto all = open.Admit(message);
  const auto admitted = signed_alone.Admit(message);
  Require(!admitted || all.has_value(), "what is signed is no less well-formed");
  if (!admitted) return;
  // Nobody else has the key: the message is one of the corpus.
  const ReplicationMessage content = all->content;
  Require(
      SignedMessage(ring.get(), content) == std::vector<uint8_t>(message.begin(), message.end()),
      "what is admitted is what was signed");
}

const FuzzTarget target{"admission", &Run};

}  // namespace splinemap::fuzz_admission
