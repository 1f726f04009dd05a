#include "splinemap/layer_settings.h"

#include <xxhash.h>

#include <algorithm>
#include <string>
#include <tuple>

namespace splinemap {
namespace {

uint64_t HashOf(const LayerId& id, const LayerSettings& setting) {
  std::string bytes;
  const auto add = [&](uint64_t value) {
    for (int shift = 0; shift < 64; shift += 8) bytes.push_back(static_cast<char>(value >> shift));
  };
  add(id.origin);
  add((setting.muted ? 1 : 0) + (setting.low_weight ? 2 : 0));
  add(static_cast<uint64_t>(setting.placement.x));
  add(static_cast<uint64_t>(setting.placement.y));
  add(static_cast<uint32_t>(setting.placement.yaw));
  add(setting.counter);
  add(setting.writer);
  add(setting.removed_up_to);
  bytes += id.name;
  return XXH3_64bits(bytes.data(), bytes.size());
}

}  // namespace

bool LayerSettings::IsValid() const {
  return placement.IsValid() && counter <= SessionId::kMaxNumber &&
         removed_up_to <= SessionId::kMaxNumber;
}

void LayerSettings::Remove(const SessionId& session) {
  muted = false;
  low_weight = false;
  placement = {};
  removed_up_to = std::max(removed_up_to, session.number | (kSessionsPerGeneration - 1));
}

LayerSettings Merge(const LayerSettings& a, const LayerSettings& b) {
  // All fields, so that there is an order even between two records of one writer's counter.
  const auto rank = [](const LayerSettings& c) {
    return std::tie(c.counter, c.writer, c.muted, c.low_weight, c.placement);
  };
  LayerSettings merged = rank(a) < rank(b) ? b : a;
  merged.removed_up_to = std::max(a.removed_up_to, b.removed_up_to);
  return merged;
}

const LayerSettings& SettingsTable::Of(const LayerId& id) const {
  static const LayerSettings kNone;
  const auto found = records_.find(id);
  return found == records_.end() ? kNone : found->second;
}

bool SettingsTable::Merge(const LayerId& id, const LayerSettings& setting) {
  const auto found = records_.find(id);
  if (found == records_.end()) {
    if (records_.size() >= kMax || setting == LayerSettings{}) return false;
    records_.emplace(id, setting);
    hash_ += HashOf(id, setting);
    return true;
  }
  const LayerSettings merged = splinemap::Merge(found->second, setting);
  if (merged == found->second) return false;
  hash_ += HashOf(id, merged) - HashOf(id, found->second);
  found->second = merged;
  return true;
}

bool SettingsTable::Merge(const SettingsTable& others) {
  bool is_new = false;
  for (const auto& [id, setting] : others.records_) is_new |= Merge(id, setting);
  return is_new;
}

void SettingsTable::Erase(const LayerId& id) {
  const auto found = records_.find(id);
  if (found == records_.end()) return;
  hash_ -= HashOf(id, found->second);
  records_.erase(found);
}

LayerSettings SettingsTable::Next(const LayerId& id, uint64_t writer) const {
  LayerSettings next = Of(id);
  next.counter = greatest_counter() + 1;
  next.writer = writer;
  return next;
}

LayerSettings SettingsTable::Removal(const LayerId& id, const SessionId& session,
                                     uint64_t writer) const {
  LayerSettings removal = Next(id, writer);
  removal.Remove(session);
  return removal;
}

uint64_t SettingsTable::greatest_counter() const {
  uint64_t greatest = 0;
  for (const auto& [id, setting] : records_) greatest = std::max(greatest, setting.counter);
  return greatest;
}

}  // namespace splinemap
