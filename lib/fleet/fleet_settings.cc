#include "lib/fleet/fleet_settings.h"

#include "lib/base/random.h"
#include "lib/base/status.h"
#include "lib/fleet/fleet_key.h"
#include "lib/store/settings_record.h"

namespace splinemap {
namespace {

constexpr int kMaxTries = 20;

// As it was in the bucket.
struct Stored {
  SettingsTable settings;  // of the layer alone
  uint64_t revision = 0;
};

absl::StatusOr<Stored> ReadStored(FleetStore& store, const LayerId& id) {
  Stored stored;
  const absl::StatusOr<FleetEntry> entry = store.Get(SettingsKey(id));
  if (absl::IsOutOfRange(entry.status())) return stored;
  if (!entry.ok()) return entry.status();
  stored.revision = entry->revision;
  if (entry->value.empty()) return stored;
  SPLINEMAP_ASSIGN_OR_RETURN(const LayerSettings settings, DecodeSettings(entry->value, id));
  stored.settings.Merge(id, settings);
  return stored;
}

}  // namespace

absl::StatusOr<LayerSettings> ReadSettings(FleetStore& store, const LayerId& id) {
  SPLINEMAP_ASSIGN_OR_RETURN(const Stored stored, ReadStored(store, id));
  return stored.settings.Of(id);
}

absl::Status ChangeSettings(FleetStore& store, const LayerId& id,
                            absl::FunctionRef<absl::Status(LayerSettings&)> change) {
  const uint64_t writer = RandomId();
  for (int n = 0; n < kMaxTries; ++n) {
    SPLINEMAP_ASSIGN_OR_RETURN(Stored stored, ReadStored(store, id));
    LayerSettings next = stored.settings.Next(id, writer);
    SPLINEMAP_RETURN_IF_ERROR(change(next));
    stored.settings.Merge(id, next);
    const FleetEntry entry{.key = SettingsKey(id),
                           .value = EncodeSettings(id, stored.settings.Of(id)),
                           .hash = stored.settings.hash()};
    const absl::Status put = store.PutIf(entry, stored.revision).status();
    if (!absl::IsAborted(put)) return put;
  }
  return Unavailable("the settings of {} are written by others all the time; try again", id.name);
}

}  // namespace splinemap
