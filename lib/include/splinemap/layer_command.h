#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <string>
#include <string_view>

#include "splinemap/layer_settings.h"

namespace splinemap {

// What clients can change about a layer, for all daemons and clients.
enum class LayerCommand { kMute, kUnmute, kLowWeight, kNormalWeight, kPlace, kRemove };

struct LayerCommandText {
  LayerCommand command;
  const char* name;  // in messages and on the command line
  const char* what;  // for --help
};
inline constexpr std::array<LayerCommandText, 6> kLayerCommands{{
    {LayerCommand::kMute, "mute", "Leave the layer out of the sum"},
    {LayerCommand::kUnmute, "unmute", "Add it to the sum again"},
    {LayerCommand::kLowWeight, "low-weight", "Let it count less than the others: its robot left"},
    {LayerCommand::kNormalWeight, "normal-weight", "Restore its normal weight"},
    {LayerCommand::kPlace, "place", "Place its frame in that of the map"},
    {LayerCommand::kRemove, "remove", "Remove it for good"},
}};

inline const char* NameOf(LayerCommand command) {
  return kLayerCommands[static_cast<size_t>(command)].name;
}
inline std::optional<LayerCommand> LayerCommandOf(std::string_view name) {
  for (const LayerCommandText& text : kLayerCommands) {
    if (name == text.name) return text.command;
  }
  return std::nullopt;
}

// What the command makes of the settings of a layer in this session; `placement` is for kPlace.
inline void Apply(LayerCommand command, const FixedPose2& placement, const SessionId& session,
                  LayerSettings& settings) {
  switch (command) {
    case LayerCommand::kMute:
    case LayerCommand::kUnmute:
      settings.muted = command == LayerCommand::kMute;
      break;
    case LayerCommand::kLowWeight:
    case LayerCommand::kNormalWeight:
      settings.low_weight = command == LayerCommand::kLowWeight;
      break;
    case LayerCommand::kPlace:
      settings.placement = placement;
      break;
    case LayerCommand::kRemove:
      settings.Remove(session);
      break;
  }
}

}  // namespace splinemap
