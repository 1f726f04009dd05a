#include "lib/map/layer_control.h"

#include <xxhash.h>

#include <algorithm>
#include <bit>
#include <cmath>
#include <string>
#include <tuple>

namespace splinemap {
namespace {

uint64_t HashOf(const LayerId& id, const LayerControl& control) {
  std::string bytes;
  const auto add = [&](uint64_t value) {
    for (int shift = 0; shift < 64; shift += 8) bytes.push_back(static_cast<char>(value >> shift));
  };
  add(id.origin);
  add((control.muted ? 1 : 0) + (control.yields ? 2 : 0));
  add(static_cast<uint32_t>(control.shift.i));
  add(static_cast<uint32_t>(control.shift.j));
  for (const double value : control.alignment) add(std::bit_cast<uint64_t>(value));
  add(control.counter);
  add(control.writer);
  add(control.removed_up_to);
  bytes += id.name;
  return XXH3_64bits(bytes.data(), bytes.size());
}

}  // namespace

bool LayerControl::IsValid() const {
  const auto is_within = [](int32_t knots) {
    return knots >= -KnotShift::kMax && knots <= KnotShift::kMax;
  };
  return is_within(shift.i) && is_within(shift.j) &&
         std::all_of(alignment.begin(), alignment.end(),
                     [](double value) { return std::isfinite(value); }) &&
         counter <= LayerEpoch::kMaxIncarnation && removed_up_to <= LayerEpoch::kMaxIncarnation;
}

LayerControl Merge(const LayerControl& a, const LayerControl& b) {
  // All fields, so that there is an order even between two records of one writer's counter.
  const auto rank = [](const LayerControl& c) {
    return std::tie(c.counter, c.writer, c.muted, c.yields, c.shift, c.alignment);
  };
  LayerControl merged = rank(a) < rank(b) ? b : a;
  merged.removed_up_to = std::max(a.removed_up_to, b.removed_up_to);
  return merged;
}

const LayerControl& LayerControls::Of(const LayerId& id) const {
  static const LayerControl kNone;
  const auto found = records_.find(id);
  return found == records_.end() ? kNone : found->second;
}

bool LayerControls::Take(const LayerId& id, const LayerControl& control) {
  const auto found = records_.find(id);
  if (found == records_.end()) {
    if (records_.size() >= kMax || control == LayerControl{}) return false;
    records_.emplace(id, control);
    hash_ += HashOf(id, control);
    return true;
  }
  const LayerControl merged = Merge(found->second, control);
  if (merged == found->second) return false;
  hash_ += HashOf(id, merged) - HashOf(id, found->second);
  found->second = merged;
  return true;
}

bool LayerControls::Take(const LayerControls& others) {
  bool is_new = false;
  for (const auto& [id, control] : others.records_) is_new |= Take(id, control);
  return is_new;
}

void LayerControls::Erase(const LayerId& id) {
  const auto found = records_.find(id);
  if (found == records_.end()) return;
  hash_ -= HashOf(id, found->second);
  records_.erase(found);
}

LayerControl LayerControls::Next(const LayerId& id, uint64_t writer) const {
  LayerControl next = Of(id);
  next.counter = greatest_counter() + 1;
  next.writer = writer;
  return next;
}

LayerControl LayerControls::Removal(const LayerId& id, uint64_t incarnation,
                                    uint64_t writer) const {
  LayerControl removal = Next(id, writer);
  removal.removed_up_to =
      std::max(removal.removed_up_to, incarnation | (LayerControl::kStartsPerGeneration - 1));
  return removal;
}

uint64_t LayerControls::greatest_counter() const {
  uint64_t greatest = 0;
  for (const auto& [id, control] : records_) greatest = std::max(greatest, control.counter);
  return greatest;
}

}  // namespace splinemap
