// The text of a configuration. What passes the checks can be printed, read again, and mapped with.

#include "lib/config/checked_text.h"
#include "lib/pipeline/mapper.h"
#include "tests/fuzz/fuzz.h"

namespace splinemap::fuzz_config {

void Run(FuzzInput input) {
  config::Config config;
  if (!ParseCheckedText(input.RestText(), "fuzz", &config).ok()) return;
  config::Config again;
  Require(ParseCheckedText(PrintDocumented(config), "printed", &again).ok(),
          "a printed configuration can be read");
  if (!CheckConfig(config).ok()) return;
  const MapOptions options = MapOptionsOf(config.method());
  Layer layer(LayerId{RobotName(config), 1}, {1, 1});
  const Mapper mapper(config, options, layer);
  Require(!mapper.channels().empty(), "a mapper has channels");
}

const FuzzTarget target("config", &Run);

}  // namespace splinemap::fuzz_config
