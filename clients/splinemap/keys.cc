#include <CLI/App.hpp>
#include <cstdio>
#include <memory>
#include <string>
#include <vector>

#include "clients/splinemap/commands.h"
#include "clients/splinemap/print.h"
#include "lib/base/status.h"
#include "lib/signing/key_files.h"

namespace splinemap {
namespace {

absl::StatusOr<int> NewKey(const std::string& folder) {
  SPLINEMAP_ASSIGN_OR_RETURN(const PublicKey key, MakeSecretKey(folder));
  PrintLine(stdout, "{}", KeyText(key));
  PrintLine(stderr,
            "this is the public key, which the others are told: splinemap keys trust. "
            "{}/own.key is the secret one; it stays on this computer",
            folder);
  return kSuccess;
}

struct TrustFlags {
  std::string folder;
  TrustedKey key;
  std::string key_text;
};

absl::StatusOr<int> TrustKey(TrustFlags flags) {
  SPLINEMAP_ASSIGN_OR_RETURN(flags.key.key, ParseKey(flags.key_text));
  SPLINEMAP_RETURN_IF_ERROR(Trust(flags.folder, flags.key));
  PrintLine(stderr, "{} is in {}, which is for all computers; daemons read it when they start",
            flags.key.name, TrustedPath(flags.folder));
  return kSuccess;
}

absl::StatusOr<int> ShowKeys(const std::string& folder) {
  SPLINEMAP_ASSIGN_OR_RETURN(const SecretKey secret, ReadSecretKey(folder));
  SPLINEMAP_ASSIGN_OR_RETURN(const std::vector<TrustedKey> trusted, ReadTrusted(folder));
  const PublicKey own = PublicKeyOf(secret);
  PrintLine(stdout, "{}", KeyText(own));
  for (const TrustedKey& key : trusted) {
    PrintLine(stdout, "{}{}", TrustedLine(key), key.key == own ? "  # this computer" : "");
  }
  return kSuccess;
}

constexpr const char* kKeysExamples = R"(
Examples:
  splinemap keys new keys                                  on each computer
  splinemap keys trust keys robot-1 KEY --maps robot-1     the keys that these printed
  splinemap keys trust keys base KEY --maps base --answers --decides
  splinemap keys trust keys laptop KEY --decides
  splinemapd --keys keys --scan LASER --pose POSE --name robot-1
  splinemap layer mute --live --keys keys --robot base robot-3

With --keys a daemon signs what it publishes, and believes nobody on the bus whose key it does not
trust. A folder has the key of its computer, own.key, and those that it trusts, trusted, a line for
each; copy trusted to all computers. What a key may do:
  --maps PATTERN  be the robot of that name, whose daemon publishes the layer
  --answers       answer for robots that are away, with what they said
  --decides       mute, place and remove layers, save and clear maps, and pass such settings on
  nothing         follow: a viewer, a planner)";

constexpr const char* kNewExamples = R"(
Example:
  splinemap keys new keys

Makes the folder where it is not there, and in it the secret key of this computer, own.key, for its
user alone. Prints the public key.)";

constexpr const char* kTrustExamples = R"(
Examples:
  splinemap keys trust keys robot-1 KEY --maps robot-1
  splinemap keys trust keys base KEY --maps base --answers --decides
  splinemap keys trust keys viewer KEY

KEY is what splinemap keys new printed there. A line of that name, or of that key, is replaced. To
trust a key no longer, delete its line in FOLDER/trusted and start the daemons again.)";

constexpr const char* kShowExamples = R"(
Example:
  splinemap keys show keys

Prints the public key of this computer, and the keys that it trusts.)";

CLI::App* AddKeysCommand(CLI::App& keys, const char* name, const char* what, const char* examples,
                         std::string& folder) {
  CLI::App* command = keys.add_subcommand(name, what);
  command->footer(examples);
  command->add_option("FOLDER", folder, "Folder of the keys of this computer")->required();
  return command;
}

}  // namespace

void AddKeys(CLI::App& app, Command& chosen) {
  CLI::App* keys = app.add_subcommand("keys", "Keys with which daemons and clients sign");
  keys->footer(kKeysExamples);
  keys->require_subcommand(1);
  auto folder = std::make_shared<std::string>();
  AddKeysCommand(*keys, "new", "Make the key of this computer", kNewExamples, *folder)
      ->callback([folder, &chosen] { chosen = [folder] { return NewKey(*folder); }; });
  AddKeysCommand(*keys, "show", "Print the keys of a folder", kShowExamples, *folder)
      ->callback([folder, &chosen] { chosen = [folder] { return ShowKeys(*folder); }; });
  auto flags = std::make_shared<TrustFlags>();
  CLI::App* trust = AddKeysCommand(*keys, "trust", "Trust a key, and say with what", kTrustExamples,
                                   flags->folder);
  trust->add_option("NAME", flags->key.name, "Who has the key, for people")->required();
  trust->add_option("KEY", flags->key_text, "Public key, 64 hexadecimal digits")->required();
  trust
      ->add_option("--maps", flags->key.maps,
                   "Robot that it may be, * and ? allowed; more than once for several")
      ->type_name("PATTERN")
      ->allow_extra_args(false);
  trust->add_flag("--answers", flags->key.answers, "It may answer for robots that are away");
  trust->add_flag("--decides", flags->key.decides,
                  "It may command, and pass settings of layers on");
  trust->callback([flags, &chosen] { chosen = [flags] { return TrustKey(*flags); }; });
}

}  // namespace splinemap
