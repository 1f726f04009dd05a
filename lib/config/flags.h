#pragma once

#include <CLI/App.hpp>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "lib/config/config.h"

namespace splinemap {

// The command line of everything that maps: splinemapd and `splinemap build`.
struct InputFlags {
  std::string config_path;
  std::vector<std::string> scans;
  std::string pose;
  std::string name;
  std::string frame;
};

void AddInputFlags(CLI::App& app, InputFlags& flags);

// The configuration file, if one is given, with the flags over it: scans on the command line
// replace those of the file. Not yet checked by CheckConfig().
absl::StatusOr<config::Config> ConfigOf(const InputFlags& flags);

}  // namespace splinemap
