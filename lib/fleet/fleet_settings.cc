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
  absl::Status damage;
};

absl::StatusOr<Stored> ReadStored(FleetStore& store, const LayerId& id) {
  Stored stored;
  const absl::StatusOr<FleetEntry> entry = store.Get(SettingsKey(id));
  if (absl::IsOutOfRange(entry.status())) return stored;
  if (!entry.ok()) return entry.status();
  stored.revision = entry->revision;
  if (entry->value.empty()) return stored;
  const absl::StatusOr<LayerSettings> settings = DecodeSettings(entry->value, id);
  stored.damage = settings.status();
  if (settings.ok()) stored.settings.Merge(id, *settings);
  return stored;
}

absl::StatusOr<uint64_t> WriteStored(FleetStore& store, const LayerId& id, const Stored& stored) {
  return store.PutIf({.key = SettingsKey(id),
                      .value = EncodeSettings(id, stored.settings.Of(id)),
                      .hash = stored.settings.hash()},
                     stored.revision);
}

absl::Status WrittenAllTheTime(const LayerId& id) {
  return Unavailable("the settings of {} are written by others all the time; try again", id.name);
}

}  // namespace

absl::StatusOr<LayerSettings> ReadSettings(FleetStore& store, const LayerId& id) {
  SPLINEMAP_ASSIGN_OR_RETURN(const Stored stored, ReadStored(store, id));
  SPLINEMAP_RETURN_IF_ERROR(stored.damage);
  return stored.settings.Of(id);
}

absl::Status ChangeSettings(FleetStore& store, const LayerId& id,
                            absl::FunctionRef<absl::Status(LayerSettings&)> change) {
  const uint64_t writer = RandomId();
  for (int n = 0; n < kMaxTries; ++n) {
    SPLINEMAP_ASSIGN_OR_RETURN(Stored stored, ReadStored(store, id));
    SPLINEMAP_RETURN_IF_ERROR(stored.damage);
    LayerSettings next = stored.settings.Next(id, writer);
    SPLINEMAP_RETURN_IF_ERROR(change(next));
    stored.settings.Merge(id, next);
    const absl::Status put = WriteStored(store, id, stored).status();
    if (!absl::IsAborted(put)) return put;
  }
  return WrittenAllTheTime(id);
}

absl::Status KeepSettings(FleetStore& store, const LayerId& id, const LayerSettings& settings) {
  for (int n = 0; n < kMaxTries; ++n) {
    SPLINEMAP_ASSIGN_OR_RETURN(Stored stored, ReadStored(store, id));
    if (!stored.settings.Merge(id, settings) && stored.damage.ok()) return absl::OkStatus();
    const absl::Status put = WriteStored(store, id, stored).status();
    if (!absl::IsAborted(put)) return put;
  }
  return WrittenAllTheTime(id);
}

}  // namespace splinemap
