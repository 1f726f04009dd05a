#include "lib/replication/settings_gossip.h"

#include <algorithm>
#include <utility>

#include "lcmtypes/splinemap/layer_settings_t.hpp"

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

}  // namespace

layer_settings_t ToMessage(const LayerId& id, const LayerSettings& setting, bool has_layer) {
  layer_settings_t message;
  message.name = id.name;
  message.origin = static_cast<int64_t>(id.origin);
  message.muted = setting.muted ? 1 : 0;
  message.low_weight = setting.low_weight ? 1 : 0;
  message.placement_x = setting.placement.x;
  message.placement_y = setting.placement.y;
  message.placement_yaw = setting.placement.yaw;
  message.counter = static_cast<int64_t>(setting.counter);
  message.writer = static_cast<int64_t>(setting.writer);
  message.removed_up_to = static_cast<int64_t>(setting.removed_up_to);
  message.has_layer = has_layer ? 1 : 0;
  return message;
}

LayerSettings FromMessage(const layer_settings_t& message) {
  return {.muted = message.muted != 0,
          .low_weight = message.low_weight != 0,
          .placement = {message.placement_x, message.placement_y, message.placement_yaw},
          .counter = static_cast<uint64_t>(message.counter),
          .writer = static_cast<uint64_t>(message.writer),
          .removed_up_to = static_cast<uint64_t>(message.removed_up_to)};
}

SettingsGossip::SettingsGossip(SettingsTable settings, uint64_t speaker)
    : settings_(std::move(settings)), random_(speaker), speaker_(static_cast<int64_t>(speaker)) {}

SettingsTable SettingsGossip::LastingSettings() const {
  SettingsTable lasting = settings_;
  for (const auto& [id, since] : strangers_) lasting.Erase(id);
  return lasting;
}

void SettingsGossip::Set(const LayerId& id, const LayerSettings& setting) {
  strangers_.erase(id);
  if (settings_.Merge(id, setting)) records_due_ = Clock::time_point::min();
}

bool SettingsGossip::IsCredible(const LayerSettings& setting, const LayerSettings& known,
                                std::optional<uint64_t> session_number, Clock::time_point now) {
  if (!setting.IsValid()) return false;
  if (session_number && setting.removed_up_to > std::max(*session_number, known.removed_up_to) +
                                                    LayerSettings::kMaxSessionsAhead) {
    return false;
  }
  const uint64_t greatest = settings_.greatest_counter();
  if (setting.counter <= greatest + LayerSettings::kMaxSettingsAhead) return true;
  if (!ahead_since_ || now - ahead_last_ > kMaxSpeakerSilence) ahead_since_ = now;
  ahead_last_ = now;
  return setting.counter <= greatest + kMaxAheadOfInsistent && now - *ahead_since_ >= kInsistence;
}

bool SettingsGossip::HandleSettings(const settings_t& message, SessionNumberOf session_number_of,
                                    Clock::time_point now) {
  if (message.speaker == speaker_) return false;
  bool is_new = false;
  for (const layer_settings_t& record : message.layers) {
    const LayerId id{record.name, static_cast<uint64_t>(record.origin)};
    const LayerSettings setting = FromMessage(record);
    const LayerSettings& known = settings_.Of(id);
    const std::optional<uint64_t> session_number = session_number_of(id);
    if (!IsCredible(setting, known, session_number, now)) {
      ++refused_;
      continue;
    }
    const bool is_known = settings_.records().contains(id);
    const bool is_here = session_number || (is_known && !strangers_.contains(id));
    if (!is_here) {
      if (!is_known && !record.has_layer && expired_.contains(id)) continue;
      if (!is_known && strangers_.size() >= kMaxStrangers) DropOldestStranger();
      if (!is_known || record.has_layer) strangers_[id] = now;
    }
    is_new |= settings_.Merge(id, setting);
  }
  if (static_cast<uint64_t>(message.hash) == settings_.hash()) {
    heard_same_ = true;
    records_due_.reset();  // somebody has told all that there is
  } else if (!records_due_) {
    records_due_ = std::max(now, last_records_ + kMinPause) + random_.UpTo(kMaxRecordsBackOff);
  }
  return is_new;
}

int64_t SettingsGossip::CountNews(const settings_t& message) const {
  return std::count_if(message.layers.begin(), message.layers.end(),
                       [&](const layer_settings_t& record) {
                         const LayerSettings& known =
                             settings_.Of({record.name, static_cast<uint64_t>(record.origin)});
                         const LayerSettings setting = FromMessage(record);
                         return setting.IsValid() && Merge(known, setting) != known;
                       });
}

bool SettingsGossip::SetHere(const LayerId& id, uint64_t session_number) {
  strangers_.erase(id);
  expired_.erase(id);
  if (settings_.Of(id).removed_up_to <= session_number + LayerSettings::kMaxSessionsAhead)
    return false;
  settings_.Erase(id);
  return true;
}

void SettingsGossip::SetStranger(const LayerId& id, Clock::time_point now) {
  if (settings_.records().contains(id)) strangers_[id] = now;
}

void SettingsGossip::DropOldestStranger() {
  const auto oldest =
      std::min_element(strangers_.begin(), strangers_.end(),
                       [](const auto& a, const auto& b) { return a.second < b.second; });
  settings_.Erase(oldest->first);
  strangers_.erase(oldest);
}

void SettingsGossip::ExpireStrangers(Clock::time_point now) {
  std::erase_if(strangers_, [&](const auto& stranger) {
    const auto& [id, since] = stranger;
    if (now - since < kStrangersStay) return false;
    settings_.Erase(id);
    if (expired_.size() < kMaxExpired) expired_[id] = now;
    return true;
  });
  std::erase_if(expired_, [&](const auto& e) { return now - e.second >= kStrangersStay; });
}

std::vector<settings_t> SettingsGossip::Tick(Clock::time_point now) {
  ExpireStrangers(now);
  std::vector<settings_t> messages;
  if (!interval_end_ || now >= *interval_end_) BeginInterval(now);
  if (records_due_ && *records_due_ <= now) {
    records_due_.reset();
    last_records_ = now;
    told_ = true;
    messages.push_back(Message());
    size_t bytes = messages.back().getEncodedSize();
    for (const auto& [id, setting] : settings_.records()) {
      const layer_settings_t record = ToMessage(id, setting, !strangers_.contains(id));
      const size_t record_bytes = record._getEncodedSizeNoHash();
      if (bytes + record_bytes > kMaxMessageBytes && messages.back().num_layers > 0) {
        messages.push_back(Message());
        bytes = messages.back().getEncodedSize();
      }
      messages.back().layers.push_back(record);
      ++messages.back().num_layers;
      bytes += record_bytes;
    }
  } else if (!heard_same_ && !told_ && now >= hash_due_) {
    told_ = true;
    messages.push_back(Message());
  }
  return messages;
}

Clock::time_point SettingsGossip::NextTick() const {
  if (!interval_end_) return {};
  Clock::time_point next = *interval_end_;
  if (!heard_same_ && !told_) next = std::min(next, hash_due_);
  return records_due_ ? std::min(next, *records_due_) : next;
}

void SettingsGossip::BeginInterval(Clock::time_point now) {
  interval_end_ = now + kInterval;
  // In the second half, so that who begins late still hears the others first.
  hash_due_ = now + kInterval / 2 + random_.UpTo(kInterval / 2);
  heard_same_ = false;
  told_ = false;
}

settings_t SettingsGossip::Message() const {
  settings_t message;
  message.speaker = speaker_;
  message.hash = static_cast<int64_t>(settings_.hash());
  message.num_layers = 0;
  return message;
}

}  // namespace splinemap
