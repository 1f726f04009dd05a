#pragma once

#include "absl/functional/function_ref.h"
#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "lib/fleet/fleet_store.h"
#include "splinemap/layer_settings.h"

namespace splinemap {

// What people have set about a layer; the default where nobody has. Errors: those of the store;
// DataLoss where what is there is damaged.
absl::StatusOr<LayerSettings> ReadSettings(FleetStore& store, const LayerId& id);

// Changes what people have set about a layer, whoever else does so meanwhile. `change` gets the
// settings as they are, and is called again where they have changed before they were written; an
// error of it ends that, and the bucket is unchanged. Errors: those of ReadSettings(); Unavailable
// where others write all the time.
absl::Status ChangeSettings(FleetStore& store, const LayerId& id,
                            absl::FunctionRef<absl::Status(LayerSettings&)> change);

// Has the bucket know these settings, merged with what it has; in place of a record that is
// damaged. Writes nothing where it knows them.
absl::Status KeepSettings(FleetStore& store, const LayerId& id, const LayerSettings& settings);

}  // namespace splinemap
