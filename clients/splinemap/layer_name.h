#pragma once

#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "lib/layers/layer.h"

namespace splinemap {

// NAME@ORIGIN, as layers are told apart in what people read and type.
std::string NameOf(const LayerId& id);

// The one of `layers` that `text` names: NAME, or NAME@ and how its origin begins. InvalidArgument
// where none is, or several are; `where` is whose layers they are: a file, a daemon.
absl::StatusOr<LayerId> FindLayer(const std::vector<LayerId>& layers, const std::string& text,
                                  const std::string& where);

}  // namespace splinemap
