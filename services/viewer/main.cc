#include <signal.h>

#include <CLI/CLI.hpp>
#include <boost/asio/io_context.hpp>
#include <boost/asio/signal_set.hpp>
#include <memory>
#include <string>
#include <utility>  // before Boost 1.74, which lacks it
#include <vector>

#include "absl/strings/ascii.h"
#include "lib/base/file.h"
#include "lib/base/plain_text.h"
#include "lib/base/status.h"
#include "lib/config/config.h"
#include "lib/config/usage_error.h"
#include "lib/fleet/fleet_flags.h"
#include "services/viewer/server.h"
#include "services/viewer/viewer.h"

namespace splinemap {
namespace {

constexpr int kFailed = 1;
constexpr int kUsage = 2;

struct Flags {
  ViewerOptions viewer;
  ServerOptions server;
  std::vector<std::string> scans;
  std::string token_file;
  std::string keys;
};

constexpr const char* kExamples = R"(
Examples:
  splinemap-viewer                                            the map of the bus, at localhost:8086
  splinemap-viewer office.splinemap --port 9000               the map of a file
  splinemap-viewer --fleet nats://hub                         the map of a fleet
  splinemap-viewer --scan LASER --pose POSE                   with the robot and its newest scan
  splinemap-viewer --allow-commands --goal-channel GOAL       goals and mutes from the page
  openssl rand -hex 16 > token
  splinemap-viewer --listen 0.0.0.0 --token-file token --certificate cert.pem --key key.pem

Without --pose every channel that carries poses is shown, without --path every one that carries
paths. Poses and scans are placed as the daemon says that maps them; where daemons of several robots
hear poses, they are taken to be in the map's frame, as paths are. Where a file keeps scans, the
page has a slider that shows the map as it was, to all who look. Serves until SIGINT (Ctrl-C) or
SIGTERM. Exit status: 0 ended by signal, 1 failed, 2 usage.)";

void AddFlags(CLI::App& app, Flags& flags) {
  app.footer(kExamples);
  app.set_version_flag("--version", SPLINEMAP_VERSION);
  app.add_option("MAP", flags.viewer.map, "Map file (default: the map on the LCM bus)");
  app.add_option("--port", flags.server.port, "Port of the page (default: 8086)")
      ->type_name("PORT");
  app.add_option("--listen", flags.server.address,
                 "Address of this computer to listen on (default: 127.0.0.1); any but loopback "
                 "needs a token and TLS")
      ->type_name("ADDRESS");
  app.add_option("--token-file", flags.token_file, "File with the token that is asked for")
      ->type_name("FILE");
  app.add_option("--certificate", flags.server.certificate_path, "Certificate chain of TLS, PEM")
      ->type_name("FILE");
  app.add_option("--key", flags.server.key_path, "Key of the certificate, PEM")->type_name("FILE");
  app.add_option("--lcm-url", flags.viewer.lcm_url, "LCM bus (default: LCM_DEFAULT_URL)")
      ->type_name("URL");
  app.add_option("--prefix", flags.viewer.watch.channel_prefix, "channel_prefix of the daemons");
  app.add_option("--keys", flags.keys,
                 "Folder of splinemap keys: sign, and believe trusted keys alone")
      ->type_name("FOLDER");
  app.add_option("--scan", flags.scans,
                 "Scan channel to show, as splinemapd takes it; more than once for several")
      ->type_name("CHANNEL[:PRESET][,OPTION=VALUE]...")
      ->allow_extra_args(false);
  app.add_option("--pose", flags.viewer.watch.poses,
                 "Pose channel to show; scans are placed by the first")
      ->type_name("CHANNEL")
      ->allow_extra_args(false);
  app.add_option("--path", flags.viewer.watch.paths, "Path channel to show (path2D_t)")
      ->type_name("CHANNEL")
      ->allow_extra_args(false);
  app.add_flag("--allow-commands", flags.viewer.allows_commands,
               "Let the page send goals, and mute layers for everybody");
  AddFleetFlags(app, flags.viewer.fleet)
      ->excludes("MAP", "--lcm-url", "--prefix", "--keys", "--path");
  app.add_option("--goal-channel", flags.viewer.goal_channel,
                 "Channel of goals, pose_xyt_t (default: GOAL)")
      ->type_name("CHANNEL");
}

// What flags say beyond their own values.
absl::Status Complete(Flags& flags) {
  for (const std::string& flag : flags.scans) {
    SPLINEMAP_ASSIGN_OR_RETURN(flags.viewer.watch.scans.emplace_back(), ParseScanFlag(flag));
  }
  if (!flags.scans.empty() && flags.viewer.watch.poses.empty())
    return InvalidArgument("--scan needs --pose: the channel of the poses to place scans by");
  const bool is_alone = !flags.viewer.map.empty() || !flags.viewer.fleet.servers.empty();
  if (is_alone &&
      (flags.viewer.allows_commands || !flags.scans.empty() || !flags.viewer.watch.poses.empty()))
    return InvalidArgument(
        "the map of a file or a fleet is shown alone: leave out --pose, --scan and "
        "--allow-commands");
  if (!flags.keys.empty()) {
    SPLINEMAP_ASSIGN_OR_RETURN(flags.viewer.watch.keys, KeyRing::Read(flags.keys));
  }
  if (flags.token_file.empty()) return absl::OkStatus();
  SPLINEMAP_ASSIGN_OR_RETURN(const std::string text, ReadFile(flags.token_file));
  flags.server.token = std::string(absl::StripAsciiWhitespace(text));
  constexpr size_t kMinToken = 16;
  const bool is_plain = std::all_of(flags.server.token.begin(), flags.server.token.end(),
                                    [](unsigned char c) { return absl::ascii_isalnum(c); });
  if (flags.server.token.size() < kMinToken || !is_plain) {
    return InvalidArgument(
        "{} is to have {} letters and digits or more, as of `openssl rand -hex 16`",
        flags.token_file, kMinToken);
  }
  return absl::OkStatus();
}

absl::Status Run(const Flags& flags) {
  boost::asio::io_context io;
  SPLINEMAP_ASSIGN_OR_RETURN(const auto viewer, Viewer::Open(io, flags.viewer));
  SPLINEMAP_ASSIGN_OR_RETURN(const auto server, Server::Listen(io, flags.server, *viewer));
  boost::asio::signal_set signals(io, SIGINT, SIGTERM);
  signals.async_wait([&](const boost::system::error_code&, int) { io.stop(); });
  fmt::print(stderr, "The map is at {} (Ctrl-C ends)\n", server->url());
  while (!io.stopped()) {
    try {
      io.run();
    } catch (const std::exception& error) {  // out of one connection
      fmt::print(stderr, "a connection was lost: {}\n", PlainText(error.what()));
    }
  }
  return absl::OkStatus();
}

int Main(int argc, char** argv) {
  CLI::App app("splinemap-viewer: shows a map, and the robots in it, in a browser.",
               "splinemap-viewer");
  Flags flags;
  AddFlags(app, flags);
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& error) {
    if (error.get_exit_code() == 0) return app.exit(error);  // --help, --version
    fmt::print(stderr, "{}\n", UsageErrorText(app, error));
    return kUsage;
  }
  if (const absl::Status complete = Complete(flags); !complete.ok()) {
    fmt::print(stderr, "{}\n", PlainLines(ErrorText(complete)));
    return kUsage;
  }
  signal(SIGPIPE, SIG_IGN);
  const absl::Status status = Run(flags);
  if (status.ok()) return 0;
  fmt::print(stderr, "{}\n", PlainLines(ErrorText(status)));
  return absl::IsInvalidArgument(status) ? kUsage : kFailed;
}

}  // namespace
}  // namespace splinemap

int main(int argc, char** argv) { return splinemap::Main(argc, argv); }
