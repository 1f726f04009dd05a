// A program of messages for a Survey, then what splinemap proposes and remarks.

#include "lib/diagnosis/survey.h"

#include <cmath>

#include "lib/diagnosis/proposal.h"
#include "tests/fuzz/fuzz.h"
#include "tests/fuzz/messages.h"

namespace splinemap::fuzz_survey {

config::Config ReadConfig(FuzzInput& input) {
  const uint8_t choice = input.Byte();
  config::Config config;
  if ((choice & 1) != 0) config.set_pose("POSE");
  if ((choice & 2) != 0) *config.add_scan() = *ParseScanFlag("SCAN:michigan_2014,mask=0..90");
  if ((choice & 4) != 0) *config.add_scan() = *ParseScanFlag("REAR,time_offset_ms=-1e9");
  return config;
}

void Run(FuzzInput input) {
  const std::string channels[] = {"POSE", "SCAN", "ODOMETRY", "REAR"};
  const config::Config given = ReadConfig(input);
  Survey survey;
  Utime clock = std::chrono::seconds(100);
  while (!input.empty()) {
    const uint8_t lag = input.Byte();
    const auto any = Utime(lag == 0xff ? input.Take<int64_t>() : 0);
    const auto add = [&](const std::string& channel, absl::Span<const uint8_t> message) {
      const Utime received = clock + lag * std::chrono::milliseconds(10);
      survey.Add(lag == 0xff ? any : received, channel, message);
    };
    if (lag == 0x80) {
      ReadDrive(input, channels, clock, add);
    } else {
      ReadMessage(input, channels, clock, add);
    }
  }
  Remarks(survey);
  const absl::StatusOr<Proposal> proposal = Propose(survey, given);
  if (!proposal.ok()) return;
  Require(proposal->scans.size() == proposal->scan_flags.size(), "a flag for each scan channel");
  for (const std::string& flag : proposal->scan_flags) {
    Require(ParseScanFlag(flag).ok(), "proposed flags can be given");
  }
  for (const FlagTrial& trial : proposal->trials) {
    if (!trial.flags) continue;
    const FlagProposal& flags = *trial.flags;
    Require(std::isfinite(flags.spread) && std::isfinite(flags.spread_given) &&
                std::isfinite(flags.spread_flipped),
            "spreads are finite");
  }
}

const FuzzTarget target("survey", &Run);

}  // namespace splinemap::fuzz_survey
