#include "services/splinemapd/command_handlers.h"

#include <algorithm>
#include <string>
#include <utility>

#include "absl/strings/escaping.h"
#include "lcmtypes/splinemap/command_request_t.hpp"
#include "lcmtypes/splinemap/layer_command_request_t.hpp"
#include "lib/base/status.h"
#include "lib/wire/decode.h"
#include "splinemap/layer_command.h"

namespace splinemap {
namespace {

std::string Quoted(const std::string& text) {
  constexpr size_t kMaxLength = 64;
  return absl::Utf8SafeCHexEscape(text.substr(0, kMaxLength));
}

absl::Status Change(LayerCommand command, const layer_command_request_t& request,
                    const FixedPose2& placement, const SessionId& session,
                    LayerSettings& settings) {
  if (command == LayerCommand::kRemove &&
      static_cast<uint64_t>(request.session_number) != session.number) {
    return FailedPrecondition("the command is for session {} of layer {}, which is in session {}",
                              request.session_number, Quoted(request.name), session.number);
  }
  Apply(command, placement, session, settings);
  return absl::OkStatus();
}

absl::StatusOr<FixedPose2> PlacementIn(const layer_command_request_t& request) {
  const Pose2 pose{{request.x_m, request.y_m}, request.yaw_rad};
  if (FixedPose2::IsInRange(pose)) return FixedPose2::Nearest(pose);
  return InvalidArgument("a placement at ({}, {}) m, turned by {} rad; {:.0f} km can be",
                         request.x_m, request.y_m, request.yaw_rad,
                         1e-3 * FixedPose2::kMaxUnits / FixedPose2::kUnitsPerMetre);
}

}  // namespace

void CommandHandlers::Execute(const std::vector<uint8_t>& command, RequestServer::Done done) {
  if (!allowed_) {
    done(absl::PermissionDeniedError(
        "splinemapd takes no commands from the bus: --no-remote-commands"));
    return;
  }
  if (const auto layer = Decode<layer_command_request_t>(command); layer.ok()) {
    ChangeLayer(*layer, std::move(done));
    return;
  }
  const auto request = Decode<command_request_t>(command);
  if (!request.ok()) {
    done(request.status());
    return;
  }
  const auto session_number = static_cast<uint64_t>(request->session_number);
  if (const absl::Status status = CheckSession(session_number); !status.ok()) {
    done(status);
  } else if (request->command == "save") {
    Save(std::move(done));
  } else if (request->command == "clear") {
    Clear(session_number, std::move(done));
  } else {
    done(InvalidArgument("no such command: {}; the commands are save and clear",
                         Quoted(request->command)));
  }
}

absl::Status CommandHandlers::CheckSession(uint64_t session_number) const {
  const uint64_t own = newest_.Own().session.number;
  if (own == session_number) return absl::OkStatus();
  return FailedPrecondition("the command is for session {} of the layer, which is in session {}",
                            session_number, own);
}

void CommandHandlers::Save(RequestServer::Done done) { saver_.Save(std::move(done)); }

void CommandHandlers::Clear(uint64_t session_number, RequestServer::Done done) {
  const LayerSnapshot own = newest_.Own();
  const SessionId next{session_number + 1, own.session.nonce};
  mapping_.StartSession(
      own.id, next, /*is_empty=*/true, [this, next, done = std::move(done)](const absl::Status& s) {
        if (s.ok()) {
          notices_.Report({.is_problem = false,
                           .subject = "clear",
                           .text = fmt::format("a client cleared the map; session {} starts empty",
                                               next.number)});
        }
        done(s);
      });
}

void CommandHandlers::ChangeLayer(const layer_command_request_t& request,
                                  RequestServer::Done done) {
  const auto command = LayerCommandOf(request.command);
  if (!command) {
    std::string names;
    for (const LayerCommandText& known : kLayerCommands) {
      names += (names.empty() ? "" : ", ") + std::string(known.name);
    }
    done(InvalidArgument("no such command: {}; the commands are {}", Quoted(request.command),
                         names));
    return;
  }
  if (*command != LayerCommand::kPlace) {
    ChangeSettings(*command, request, {}, std::move(done));
    return;
  }
  const absl::StatusOr<FixedPose2> placement = PlacementIn(request);
  const LayerSnapshot own = newest_.Own();
  if (!placement.ok()) {
    done(placement.status());
  } else if (own.id != LayerId{request.name, static_cast<uint64_t>(request.origin)}) {
    ChangeSettings(*command, request, *placement, std::move(done));
  } else if (own.archive->base.IsEmpty()) {
    PlaceOwn(request, *placement, std::move(done));
  } else {
    // Beyond where the base was mapped.
    ChangeSettings(*command, request, *placement / own.archive->map_T_world, std::move(done));
  }
}

// Exactly, since all scans of the layer are kept.
void CommandHandlers::PlaceOwn(const layer_command_request_t& request, const FixedPose2& placement,
                               RequestServer::Done done) {
  folding_.Fold(
      "placed",
      [placement](const ScanArchive&) -> absl::StatusOr<ArchiveEdit> {
        ArchiveEdit edit;
        edit.map_T_world = placement;
        return edit;
      },
      [this, request, done = std::move(done)](const absl::Status& placed) {
        if (!placed.ok()) {
          done(placed);
        } else if (newest_.Layers()->settings.Of(newest_.Own().id).placement.IsIdentity()) {
          saver_.Save(done);
        } else {
          // In place of what was set while it was away.
          ChangeSettings(LayerCommand::kPlace, request, {}, done);
        }
      });
}

void CommandHandlers::ChangeSettings(LayerCommand command, const layer_command_request_t& request,
                                     const FixedPose2& placement, RequestServer::Done done) {
  const LayerId id{request.name, static_cast<uint64_t>(request.origin)};
  std::string text = NameOf(command);
  if (command == LayerCommand::kPlace) {
    text +=
        fmt::format(" at ({}, {}) m, turned by {} rad", request.x_m, request.y_m, request.yaw_rad);
  }
  replication_.Edit(
      id,
      [command, request, placement](const SessionId& session, LayerSettings& settings) {
        return Change(command, request, placement, session, settings);
      },
      [this, command, text, client = static_cast<uint64_t>(request.header.client), id,
       done = std::move(done)](const absl::Status& changed) {
        if (!changed.ok()) {
          done(changed);
          return;
        }
        const std::string name = Quoted(id.name);
        notices_.Report(
            {.is_problem = false,
             .subject = fmt::format("layers {} {}", NameOf(command), name),
             .text = fmt::format("client {:016x} sent {} for layer {}", client, text, name)});
        saver_.Save(done);
      });
}

}  // namespace splinemap
