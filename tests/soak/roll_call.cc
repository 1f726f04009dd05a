// roll_call NAME..: waits until the daemons of these names say the same about all layers that they
// have, as splinemap.layers_t, and prints the seconds that it took. Otherwise it prints who says
// what.
#include <fmt/ranges.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <chrono>
#include <cstdint>
#include <map>
#include <string>
#include <vector>

#include "lcmtypes/splinemap/layer_status_t.hpp"
#include "lcmtypes/splinemap/layers_t.hpp"
#include "lib/base/status.h"
#include "lib/replica/caller.h"
#include "lib/wire/decode.h"
#include "lib/wire/lcm_bus.h"

namespace splinemap {
namespace {

using SteadyClock = std::chrono::steady_clock;
using Seconds = std::chrono::duration<double>;

// One line a layer, with all that has to be equal; what is empty or removed alike is no difference.
std::vector<std::string> RowsOf(const layers_t& layers) {
  std::vector<std::string> lines;
  for (const layer_status_t& layer : layers.layers) {
    if (layer.num_tiles == 0) continue;
    lines.push_back(fmt::format("{}@{:016x}: session {} {:016x}, {} tiles {:016x}{}",
                                layer.settings.name, static_cast<uint64_t>(layer.settings.origin),
                                layer.session_number, static_cast<uint64_t>(layer.session_nonce),
                                layer.num_tiles, static_cast<uint64_t>(layer.hash),
                                layer.state == "stale" ? ", stale" : ""));
  }
  std::sort(lines.begin(), lines.end());
  lines.push_back(fmt::format("settings {:016x}", static_cast<uint64_t>(layers.settings_hash)));
  return lines;
}

absl::Status Run(const std::vector<std::string>& names, double timeout_s) {
  SPLINEMAP_ASSIGN_OR_RETURN(const auto bus, LcmBus::Open(""));
  std::map<std::string, std::vector<std::string>> said;
  bus->Subscribe("SPLINEMAP_LAYERS", [&](const std::string&, absl::Span<const uint8_t> message) {
    const auto layers = Decode<layers_t>(message);
    if (!layers.ok() || std::count(names.begin(), names.end(), layers->name) == 0) return;
    said[layers->name] = RowsOf(*layers);
  });
  Caller caller(*bus, "SPLINEMAP");
  const auto begin = SteadyClock::now();
  const auto passed_s = [&] { return Seconds(SteadyClock::now() - begin).count(); };
  const auto agree = [&] {
    return said.size() == names.size() &&
           std::all_of(said.begin(), said.end(),
                       [&](const auto& one) { return one.second == said.begin()->second; });
  };
  while (!agree()) {
    if (passed_s() > timeout_s) {
      for (const auto& [name, lines] : said)
        fmt::print(stderr, "{}: {}\n", name, fmt::join(lines, "; "));
      return Unavailable("{} of {} daemons are heard, and do not agree", said.size(), names.size());
    }
    caller.Tick(Clock::now());
    bus->Handle(std::chrono::milliseconds(100));
  }
  fmt::print("{:.1f}\n", passed_s());
  return absl::OkStatus();
}

int Main(int argc, char** argv) {
  CLI::App app("roll_call: waits until daemons have the same layers, on LCM_DEFAULT_URL");
  std::vector<std::string> names;
  double timeout_s = 30;
  app.add_option("NAME", names, "Names of daemons")->required();
  app.add_option("--timeout", timeout_s, "s");
  CLI11_PARSE(app, argc, argv);
  if (absl::Status status = Run(names, timeout_s); !status.ok()) {
    fmt::print(stderr, "roll_call: {}\n", ErrorText(status));
    return 1;
  }
  return 0;
}

}  // namespace
}  // namespace splinemap

int main(int argc, char** argv) { return splinemap::Main(argc, argv); }
