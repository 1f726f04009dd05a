#include "lib/replication/control_gossip.h"

#include <algorithm>
#include <utility>

namespace splinemap {
namespace {

using std::chrono::milliseconds;

constexpr milliseconds kInterval(1000);
// Of several who know what another one does not, one speaks first.
constexpr milliseconds kMaxBackOff(200);
constexpr milliseconds kMinPause(500);  // between two tellings of all records

layer_control_t ToMessage(const LayerId& id, const LayerControl& control) {
  layer_control_t message;
  message.name = id.name;
  message.origin = static_cast<int64_t>(id.origin);
  message.muted = control.muted ? 1 : 0;
  message.yields = control.yields ? 1 : 0;
  message.shift_i = control.shift.i;
  message.shift_j = control.shift.j;
  message.x_m = control.alignment[0];
  message.y_m = control.alignment[1];
  message.yaw_rad = control.alignment[2];
  message.counter = static_cast<int64_t>(control.counter);
  message.writer = static_cast<int64_t>(control.writer);
  message.removed_up_to = static_cast<int64_t>(control.removed_up_to);
  return message;
}

LayerControl FromMessage(const layer_control_t& message) {
  return {.muted = message.muted != 0,
          .yields = message.yields != 0,
          .shift = {message.shift_i, message.shift_j},
          .alignment = {message.x_m, message.y_m, message.yaw_rad},
          .counter = static_cast<uint64_t>(message.counter),
          .writer = static_cast<uint64_t>(message.writer),
          .removed_up_to = static_cast<uint64_t>(message.removed_up_to)};
}

}  // namespace

ControlGossip::ControlGossip(LayerControls controls, uint64_t seed)
    : controls_(std::move(controls)), random_(seed), sender_(static_cast<int64_t>(seed)) {}

void ControlGossip::Decide(const LayerId& id, const LayerControl& control) {
  if (controls_.Take(id, control)) records_due_ = Clock::time_point::min();
}

bool ControlGossip::Take(const control_records_t& message, Clock::time_point now) {
  if (message.sender == sender_) return false;
  bool is_new = false;
  for (const layer_control_t& record : message.records) {
    const LayerControl control = FromMessage(record);
    if (!control.IsValid()) {
      ++invalid_;
      continue;
    }
    is_new |= controls_.Take({record.name, static_cast<uint64_t>(record.origin)}, control);
  }
  if (static_cast<uint64_t>(message.hash) == controls_.hash()) {
    heard_same_ = true;
    records_due_.reset();  // somebody has told all that there is
  } else if (!records_due_) {
    records_due_ = std::max(now, last_records_ + kMinPause) + random_.UpTo(kMaxBackOff);
  }
  return is_new;
}

std::vector<control_records_t> ControlGossip::Tick(Clock::time_point now) {
  std::vector<control_records_t> messages;
  if (!interval_end_ || now >= *interval_end_) BeginInterval(now);
  if (records_due_ && *records_due_ <= now) {
    records_due_.reset();
    last_records_ = now;
    told_ = true;
    messages.push_back(Message());
    size_t bytes = messages.back().getEncodedSize();
    for (const auto& [id, control] : controls_.records()) {
      const layer_control_t record = ToMessage(id, control);
      const size_t record_bytes = record._getEncodedSizeNoHash();
      if (bytes + record_bytes > kMaxMessageBytes && messages.back().num_records > 0) {
        messages.push_back(Message());
        bytes = messages.back().getEncodedSize();
      }
      messages.back().records.push_back(record);
      ++messages.back().num_records;
      bytes += record_bytes;
    }
  } else if (!heard_same_ && !told_ && now >= hash_due_) {
    told_ = true;
    messages.push_back(Message());
  }
  return messages;
}

void ControlGossip::BeginInterval(Clock::time_point now) {
  interval_end_ = now + kInterval;
  // In the second half, so that who begins late still hears the others first.
  hash_due_ = now + kInterval / 2 + random_.UpTo(kInterval / 2);
  heard_same_ = false;
  told_ = false;
}

control_records_t ControlGossip::Message() const {
  control_records_t message;
  message.sender = sender_;
  message.hash = static_cast<int64_t>(controls_.hash());
  message.num_records = 0;
  return message;
}

}  // namespace splinemap
