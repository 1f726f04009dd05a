#pragma once

#include <string>

#include "absl/status/statusor.h"
#include "lib/store/records.pb.h"
#include "splinemap/layer_settings.h"

namespace splinemap {

store::LayerName ToRecord(const LayerId& id);
LayerId FromRecord(const store::LayerName& record);

store::SettingsRecord ToRecord(const LayerId& id, const LayerSettings& setting);
// Placements of files of before were whole knots.
LayerSettings FromRecord(const store::SettingsRecord& record, double knot_interval_m);

// The record alone, as bytes. DataLoss where it is damaged or of another layer, InvalidArgument for
// what cannot be.
std::string EncodeSettings(const LayerId& id, const LayerSettings& setting);
absl::StatusOr<LayerSettings> DecodeSettings(const std::string& value, const LayerId& id);

}  // namespace splinemap
