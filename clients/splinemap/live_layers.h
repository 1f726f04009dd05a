#pragma once

#include <CLI/App.hpp>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "lcmtypes/splinemap/layer_status_t.hpp"
#include "lcmtypes/splinemap/layers_t.hpp"
#include "lib/layers/layer_settings.h"

namespace splinemap {

struct LiveFlags {
  std::string lcm_url;
  std::string channel_prefix = "SPLINEMAP";
  double wait_s = 1.5;  // for daemons, which speak once a second
};

void AddLiveFlags(CLI::App& command, LiveFlags& flags);

// What all daemons on the bus say of their layers, by name. NotFound where there is none.
absl::StatusOr<std::vector<layers_t>> ListenToLayers(const LiveFlags& flags);

}  // namespace splinemap
