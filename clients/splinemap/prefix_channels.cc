#include <CLI/App.hpp>
#include <cstdio>
#include <memory>
#include <string>
#include <vector>

#include "clients/splinemap/commands.h"
#include "clients/splinemap/files.h"
#include "clients/splinemap/print.h"
#include "clients/splinemap/progress.h"
#include "lib/base/status.h"
#include "lib/logs/lcm_log.h"

namespace splinemap {
namespace {

struct PrefixChannelsFlags {
  std::string log;
  std::string prefix;
  Output output;
};

absl::StatusOr<int> PrefixChannels(const PrefixChannelsFlags& flags) {
  constexpr size_t kMaxChannelBytes = 63;  // of LCM
  SPLINEMAP_RETURN_IF_ERROR(CheckOutput(flags.output, {flags.log}));
  SPLINEMAP_ASSIGN_OR_RETURN(LcmLogWriter writer, LcmLogWriter::Create(flags.output.path));
  absl::Status written;
  int64_t messages = 0;
  const auto write = [&](const LogEvent& event) {
    if (!written.ok()) return;
    const std::string channel = flags.prefix + event.channel;
    if (channel.size() > kMaxChannelBytes) {
      written = InvalidArgument("channel {} is too long; LCM has room for {} bytes", channel,
                                kMaxChannelBytes);
      return;
    }
    std::vector<uint8_t> message(event.message.begin(), event.message.end());
    written = writer.WriteBytes(event.utime, channel, message);
    ++messages;
  };
  absl::Status read;
  {
    ProgressBar bar("copying");
    read = ReadLcmLog(flags.log, write, [&](double share) { bar.Show(share); });
  }
  SPLINEMAP_RETURN_IF_ERROR(written);
  if (messages == 0) return read;
  SPLINEMAP_RETURN_IF_ERROR(writer.Close());
  PrintLine(stderr, "{} messages written to {}", messages, flags.output.path);
  SPLINEMAP_RETURN_IF_ERROR(read);
  return kSuccess;
}

constexpr const char* kPrefixChannelsExamples = R"(
Example:
  splinemap prefix-channels drive.lcmlog robot-1_ robot-1.lcmlog

LASER becomes robot-1_LASER, and so on: so that logs of several robots, which have the same
channels, can be played on one bus.)";

}  // namespace

void AddPrefixChannels(CLI::App& app, Command& chosen) {
  auto flags = std::make_shared<PrefixChannelsFlags>();
  CLI::App* command =
      app.add_subcommand("prefix-channels", "Put a prefix before the channels of an LCM log");
  command->footer(kPrefixChannelsExamples);
  command->add_option("LOG", flags->log, "LCM log, plain or gzip")->required();
  command->add_option("PREFIX", flags->prefix, "What all channels begin with")->required();
  AddOutput(*command, "OUT", "LCM log to write", flags->output);
  command->callback([flags, &chosen] { chosen = [flags] { return PrefixChannels(*flags); }; });
}

}  // namespace splinemap
