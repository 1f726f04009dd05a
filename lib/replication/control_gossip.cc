#include "lib/replication/control_gossip.h"

#include <algorithm>
#include <utility>

namespace splinemap {
namespace {

using std::chrono::milliseconds;

constexpr milliseconds kInterval(1000);
// Of several who know what another one does not, one speaks first.
constexpr milliseconds kMaxRecordsBackOff(200);
constexpr milliseconds kMinPause(500);  // between two tellings of all records
// What is told for so long, with pauses of no more than that, is no single message. It can be ahead
// by so much then.
constexpr milliseconds kInsistence(10'000);
constexpr milliseconds kMaxSpeakerSilence(3500);
constexpr uint64_t kMaxAheadOfInsistent = uint64_t{1} << 48;
constexpr size_t kMaxExpired = 1024;

layer_control_t ToMessage(const LayerId& id, const LayerControl& control, bool has_layer) {
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
  message.has_layer = has_layer ? 1 : 0;
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

LayerControls ControlGossip::LastingControls() const {
  LayerControls lasting = controls_;
  for (const auto& [id, since] : strangers_) lasting.Erase(id);
  return lasting;
}

void ControlGossip::Decide(const LayerId& id, const LayerControl& control) {
  strangers_.erase(id);
  if (controls_.Take(id, control)) records_due_ = Clock::time_point::min();
}

bool ControlGossip::IsCredible(const LayerControl& control, const LayerControl& known,
                               std::optional<uint64_t> incarnation, Clock::time_point now) {
  if (!control.IsValid()) return false;
  if (incarnation && control.removed_up_to > std::max(*incarnation, known.removed_up_to) +
                                                 LayerControl::kMaxStartsAhead) {
    return false;
  }
  const uint64_t greatest = controls_.greatest_counter();
  if (control.counter <= greatest + LayerControl::kMaxDecisionsAhead) return true;
  if (!ahead_since_ || now - ahead_last_ > kMaxSpeakerSilence) ahead_since_ = now;
  ahead_last_ = now;
  return control.counter <= greatest + kMaxAheadOfInsistent && now - *ahead_since_ >= kInsistence;
}

bool ControlGossip::Take(const control_records_t& message, IncarnationOf incarnation_of,
                         Clock::time_point now) {
  if (message.sender == sender_) return false;
  bool is_new = false;
  for (const layer_control_t& record : message.records) {
    const LayerId id{record.name, static_cast<uint64_t>(record.origin)};
    const LayerControl control = FromMessage(record);
    const LayerControl& known = controls_.Of(id);
    const std::optional<uint64_t> incarnation = incarnation_of(id);
    if (!IsCredible(control, known, incarnation, now)) {
      ++refused_;
      continue;
    }
    const bool is_known = controls_.records().contains(id);
    const bool is_here = incarnation || (is_known && !strangers_.contains(id));
    if (!is_here) {
      if (!is_known && !record.has_layer && expired_.contains(id)) continue;
      if (!is_known && strangers_.size() >= kMaxStrangers) DropOldestStranger();
      if (!is_known || record.has_layer) strangers_[id] = now;
    }
    is_new |= controls_.Take(id, control);
  }
  if (static_cast<uint64_t>(message.hash) == controls_.hash()) {
    heard_same_ = true;
    records_due_.reset();  // somebody has told all that there is
  } else if (!records_due_) {
    records_due_ = std::max(now, last_records_ + kMinPause) + random_.UpTo(kMaxRecordsBackOff);
  }
  return is_new;
}

int64_t ControlGossip::CountNews(const control_records_t& message) const {
  return std::count_if(message.records.begin(), message.records.end(),
                       [&](const layer_control_t& record) {
                         const LayerControl& known =
                             controls_.Of({record.name, static_cast<uint64_t>(record.origin)});
                         const LayerControl control = FromMessage(record);
                         return control.IsValid() && Merge(known, control) != known;
                       });
}

bool ControlGossip::SetHere(const LayerId& id, uint64_t incarnation) {
  strangers_.erase(id);
  expired_.erase(id);
  if (controls_.Of(id).removed_up_to <= incarnation + LayerControl::kMaxStartsAhead) return false;
  controls_.Erase(id);
  return true;
}

void ControlGossip::SetStranger(const LayerId& id, Clock::time_point now) {
  if (controls_.records().contains(id)) strangers_[id] = now;
}

void ControlGossip::DropOldestStranger() {
  const auto oldest =
      std::min_element(strangers_.begin(), strangers_.end(),
                       [](const auto& a, const auto& b) { return a.second < b.second; });
  controls_.Erase(oldest->first);
  strangers_.erase(oldest);
}

void ControlGossip::ExpireStrangers(Clock::time_point now) {
  std::erase_if(strangers_, [&](const auto& stranger) {
    const auto& [id, since] = stranger;
    if (now - since < kStrangersStay) return false;
    controls_.Erase(id);
    if (expired_.size() < kMaxExpired) expired_[id] = now;
    return true;
  });
  std::erase_if(expired_, [&](const auto& e) { return now - e.second >= kStrangersStay; });
}

std::vector<control_records_t> ControlGossip::Tick(Clock::time_point now) {
  ExpireStrangers(now);
  std::vector<control_records_t> messages;
  if (!interval_end_ || now >= *interval_end_) BeginInterval(now);
  if (records_due_ && *records_due_ <= now) {
    records_due_.reset();
    last_records_ = now;
    told_ = true;
    messages.push_back(Message());
    size_t bytes = messages.back().getEncodedSize();
    for (const auto& [id, control] : controls_.records()) {
      const layer_control_t record = ToMessage(id, control, !strangers_.contains(id));
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
