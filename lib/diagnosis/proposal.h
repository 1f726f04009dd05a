#pragma once

#include <cstddef>
#include <optional>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "lib/config/config.h"
#include "lib/diagnosis/sensor_option_search.h"
#include "lib/diagnosis/survey.h"

namespace splinemap {

// How a scan channel fares with a pose channel.
struct FlagTrial {
  std::string scan;
  std::string pose;
  Utime clock_offset{0};              // brings the scans to the clock of the poses; 0 for one clock
  size_t scans = 0;                   // that were compared; the same ones for each pose channel
  std::optional<FlagProposal> flags;  // nothing where the drive does not tell
  // Cells with the options as they are given, not even with what stamps and readings ask for;
  // nothing where these place fewer than nine in ten of the hits.
  std::optional<double> spread_as_given;
};

// A pose channel and the flags of each scan channel with it.
struct FlagChoice {
  std::string pose;
  std::vector<std::string> scan_flags;
};

// How to map what was surveyed.
struct Proposal {
  std::string pose;
  std::vector<std::string> scans;       // channels
  std::vector<std::string> scan_flags;  // for each, what to give to --scan
  std::vector<FlagTrial> trials;
  std::optional<FlagChoice> close_second;  // that makes nearly as sharp a map, or one of few scans
  std::vector<std::string> cautions;       // what speaks against it, a sentence each
  // Why the flags are not to be mapped with yet, or empty: the right time offset lies beyond those
  // that were tried. A search that begins with these flags goes on from there.
  std::string problem;
};

// Chooses the pose channel with which the map gets sharpest, and the flags of each scan channel,
// by SearchFlags() on the first minutes. Channels that `given` has are taken, its options are where
// the search begins. InvalidArgument in words where there is nothing to choose from, or where the
// robot moved too little to choose.
absl::StatusOr<Proposal> Propose(const Survey& survey, const config::Config& given);

// A sentence on a pose channel with which the map gets clearly sharper than with that of `config`,
// which has channels, by Propose(); or nothing.
std::string SharperPoses(const Survey& survey, const config::Config& config);

// What is odd about the channels of scans and poses, a sentence each: repeated messages, gaps,
// other clocks, useless beam times, damage.
std::vector<std::string> Remarks(const Survey& survey);

}  // namespace splinemap
