#include "lib/store/settings_record.h"

#include "lib/base/status.h"
#include "splinemap/fixed_pose2.h"

namespace splinemap {
namespace {

// What cannot be is no valid placement.
FixedPose2 PlacementOf(const store::SettingsRecord& record, double knot_interval_m) {
  if (record.shift_i() == 0 && record.shift_j() == 0) {
    return {record.placement_x(), record.placement_y(), record.placement_yaw()};
  }
  const Pose2 pose{{record.shift_i() * knot_interval_m, record.shift_j() * knot_interval_m}, 0};
  return FixedPose2::IsInRange(pose) ? FixedPose2::Nearest(pose)
                                     : FixedPose2{.x = FixedPose2::kMaxUnits + 1};
}

}  // namespace

store::LayerName ToRecord(const LayerId& id) {
  store::LayerName record;
  record.set_name(id.name);
  record.set_origin(id.origin);
  return record;
}

LayerId FromRecord(const store::LayerName& record) { return {record.name(), record.origin()}; }

store::SettingsRecord ToRecord(const LayerId& id, const LayerSettings& setting) {
  store::SettingsRecord record;
  *record.mutable_layer() = ToRecord(id);
  record.set_muted(setting.muted);
  record.set_low_weight(setting.low_weight);
  record.set_placement_x(setting.placement.x);
  record.set_placement_y(setting.placement.y);
  record.set_placement_yaw(setting.placement.yaw);
  record.set_counter(setting.counter);
  record.set_writer(setting.writer);
  record.set_removed_up_to(setting.removed_up_to);
  return record;
}

LayerSettings FromRecord(const store::SettingsRecord& record, double knot_interval_m) {
  return {.muted = record.muted(),
          .low_weight = record.low_weight(),
          .placement = PlacementOf(record, knot_interval_m),
          .counter = record.counter(),
          .writer = record.writer(),
          .removed_up_to = record.removed_up_to()};
}

std::string EncodeSettings(const LayerId& id, const LayerSettings& setting) {
  return ToRecord(id, setting).SerializeAsString();
}

absl::StatusOr<LayerSettings> DecodeSettings(const std::string& value, const LayerId& id) {
  store::SettingsRecord record;
  if (!record.ParseFromString(value)) return DataLoss("it is no record of settings");
  if (FromRecord(record.layer()) != id) return DataLoss("it is of another layer");
  const LayerSettings settings = FromRecord(record, /*knot_interval_m=*/1);
  if (record.shift_i() != 0 || record.shift_j() != 0 || !settings.IsValid()) {
    return InvalidArgument("such settings cannot be");
  }
  return settings;
}

}  // namespace splinemap
