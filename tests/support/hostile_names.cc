// hostile_names bus | log FILE | map FILE VALUE: escape codes, line ends, bytes that are no UTF-8
// and markup in every text that splinemap takes. Publishes them, as daemons and robots would, and
// answers who asks; or writes a log whose channels, or a map of one value whose layers have such
// names.
#include <fmt/format.h>

#include <chrono>
#include <cmath>
#include <string>
#include <vector>

#include "lcmtypes/splinemap/layer_digest_t.hpp"
#include "lcmtypes/splinemap/layer_status_t.hpp"
#include "lcmtypes/splinemap/layers_t.hpp"
#include "lcmtypes/splinemap/points_reply_t.hpp"
#include "lcmtypes/splinemap/points_request_t.hpp"
#include "lcmtypes/splinemap/status_t.hpp"
#include "lib/base/random.h"
#include "lib/base/status.h"
#include "lib/config/config.h"
#include "lib/logs/lcm_log.h"
#include "lib/replication/protocol.h"
#include "lib/wire/decode.h"
#include "lib/wire/encode.h"
#include "lib/wire/lcm_bus.h"
#include "splinemap/file.h"
#include "tests/support/map_writer.h"

namespace splinemap {
namespace {

constexpr const char* kMarkup = "<img src=//hostile onerror=alert(1)>";

// Marked by X, which says where it came out.
std::string Hostile(const std::string& x) {
  return x + "\x1b[2J\n\r\x9b\x07\xff\xc2\x9b" + x + kMarkup;
}

status_t Status() {
  status_t status{};
  status.name = Hostile("Xname");
  status.version = Hostile("Xversion");
  status.drop_reasons = {Hostile("Xreason")};
  status.drop_counts = {1};
  status.num_drop_reasons = 1;
  status.problems = {Hostile("Xproblem")};
  status.problem_counts = {1};
  status.num_problems = 1;
  status.last_problem = Hostile("Xlast");
  return status;
}

layers_t Layers() {
  layers_t layers{};
  layers.name = Hostile("Xdaemon");
  layers.refused = {Hostile("Xrefused")};
  layers.num_refused = 1;
  layer_status_t layer{};
  layer.settings.name = Hostile("Xlayer");
  layer.state = Hostile("Xstate");
  layers.layers = {layer};
  layers.num_layers = 1;
  return layers;
}

// Of a layer that cannot be followed, which is said with its name; one that can, but for what is
// missing; and two of one name.
layer_digest_t Digest(const std::string& name, int64_t origin, double knot_interval_m) {
  layer_digest_t digest{};
  digest.layer.name = Hostile(name);
  digest.layer.origin = origin;
  digest.layer.session_number = 1;
  digest.layer.session_nonce = 1;
  digest.speaker = 1;
  digest.protocol_version = kProtocolVersion;
  digest.knot_interval_m = knot_interval_m;
  digest.root_level = 1;
  const ControlLimits limits = MapOptionsOf(config::Method()).limits;  // of daemons by themselves
  digest.min_control_point = limits.min;
  digest.max_control_point = limits.max;
  digest.revision = 1;
  digest.state = 1;
  return digest;
}

absl::Status Shout() {
  SPLINEMAP_ASSIGN_OR_RETURN(const auto bus, LcmBus::Open(""));
  bus->Subscribe("SPLINEMAP_POINTS_REQUESTS",
                 [&](const std::string&, absl::Span<const uint8_t> message) {
                   const auto request = Decode<points_request_t>(message);
                   if (!request.ok()) return;
                   points_reply_t reply{};
                   reply.header.id = request->header.id;
                   reply.header.name = Hostile("Xrobot");
                   reply.header.daemon_nonce = 7;
                   reply.header.session_number = 1;
                   if (request->num_points > 0) {
                     reply.header.status = 3;
                     reply.header.status_text = Hostile("Xtext");
                   }
                   const auto client = static_cast<uint64_t>(request->header.client);
                   bus->Publish(fmt::format("SPLINEMAP_REPLIES_{:016x}", client), reply);
                 });
  for (auto next = std::chrono::steady_clock::now();; bus->Handle(std::chrono::milliseconds(10))) {
    if (std::chrono::steady_clock::now() < next) continue;
    next += std::chrono::milliseconds(200);
    bus->Publish("SPLINEMAP_STATUS", Status());
    bus->Publish("SPLINEMAP_LAYERS", Layers());
    bus->Publish("SPLINEMAP_DIGESTS", Digest("Xcoarse", 1, 0.77));
    bus->Publish("SPLINEMAP_DIGESTS", Digest("Xmissing", 2, 0.05));
    bus->Publish("SPLINEMAP_DIGESTS", Digest("Xtwice", 3, 0.05));
    bus->Publish("SPLINEMAP_DIGESTS", Digest("Xtwice", 4, 0.05));
    // liblcm subscribes to no channel with an end of line, or no UTF-8, in its name.
    bus->Publish(std::string("Xchannel\x1b[2J\x07Xchannel") + kMarkup, PoseMessage({}));
    const uint8_t wrong_type[16] = {1};
    for (const char* channel : {"LASER", "POSE"}) bus->PublishBytes(channel, wrong_type);
  }
}

absl::Status WriteLog(const std::string& path) {
  SPLINEMAP_ASSIGN_OR_RETURN(LcmLogWriter writer, LcmLogWriter::Create(path));
  std::vector<float> ranges_m;
  for (int k = 0; k < 90; ++k) ranges_m.push_back(2 + 0.02F * static_cast<float>(k));
  for (int n = 0; n < 100; ++n) {
    const Utime utime(1'000'000 + 100'000 * n);
    for (const char* pose : {"Xpose1", "Xpose2"}) {
      SPLINEMAP_RETURN_IF_ERROR(
          writer.Write(utime, Hostile(pose), PoseMessage({utime, {{0.01 * n, 0}, 0.01 * n}})));
    }
    for (const char* scan : {"Xscan1", "Xscan2"}) {
      SPLINEMAP_RETURN_IF_ERROR(
          writer.Write(utime, Hostile(scan), PlanarLidarMessage(utime, ranges_m, 0, M_PI / 45)));
    }
  }
  return writer.Close();
}

absl::Status WriteMap(const std::string& path, ControlPoint value) {
  MapWriter map(MapOptionsOf(config::Method()));
  for (const char* name : {"Xfirst", "Xsecond", "Xmuted"}) {
    Layer& layer = map.AddLayer({Hostile(name), RandomId()}, {1, 1});
    layer.BeginCommit();
    layer.EditTile({0, 0}).control_points.fill(value);
  }
  LayerSet set = map.Layers();
  LayerSettings muted;
  muted.muted = true;
  muted.counter = 1;
  set.settings.Merge(set.layers.back().id, muted);
  SPLINEMAP_ASSIGN_OR_RETURN(MapFile file, MapFile::Open(path));
  SPLINEMAP_RETURN_IF_ERROR(file.Save(set).status());
  return file.Close();
}

absl::Status Run(const std::vector<std::string>& words) {
  if (words.size() == 2 && words[0] == "log") return WriteLog(words[1]);
  if (words.size() == 3 && words[0] == "map") {
    return WriteMap(words[1], static_cast<ControlPoint>(std::stoi(words[2])));
  }
  return words == std::vector<std::string>{"bus"}
             ? Shout()
             : absl::InvalidArgumentError("bus | log FILE | map FILE VALUE");
}

}  // namespace
}  // namespace splinemap

int main(int argc, char** argv) {
  const absl::Status status = splinemap::Run({argv + 1, argv + argc});
  if (!status.ok()) fmt::print(stderr, "hostile_names: {}\n", splinemap::ErrorText(status));
  return status.ok() ? 0 : 1;
}
