#pragma once

#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "splinemap/layer.h"

namespace splinemap {

// NAME@ORIGIN, the name of a layer for people.
std::string NameOf(const LayerId& id);

// The one of `layers` that `text` names: NAME, or NAME@ and the first digits of its origin.
// InvalidArgument for none or several; `where` names the file or the daemons that have the layers.
absl::StatusOr<LayerId> FindLayer(const std::vector<LayerId>& layers, const std::string& text,
                                  const std::string& where);

}  // namespace splinemap
