#include "lib/replication/levels_publisher.h"

#include <algorithm>
#include <chrono>
#include <utility>

namespace splinemap {
namespace {

// A level that nobody has asked for in this time is given up.
constexpr std::chrono::seconds kLevelLease(30);
// Tiles of coarser levels that are made in one tick, some milliseconds of work.
constexpr size_t kTilesPerTick = 200;

}  // namespace

LevelsPublisher::LevelsPublisher(const LayerSnapshot& layer, const MapOptions& map_options,
                                 const PublisherOptions& options)
    : life_{layer.id, layer.epoch, {}},
      map_options_(map_options),
      options_(options),
      layer_(layer),
      budget_(options.bytes_per_s),
      as_mapped_(life_, layer, map_options, options) {}

void LevelsPublisher::SetLayer(const LayerSnapshot& layer, Clock::time_point now) {
  layer_ = layer;
  as_mapped_.SetLayer(layer, now);
}

void LevelsPublisher::TakePull(const layer_pull_t& pull, Clock::time_point now) {
  const LayerLife life = FromMessage(pull.layer);
  if (life.id != life_.id || life.epoch != life_.epoch || !life.detail.IsValid()) {
    ++foreign_pulls_;
    return;
  }
  if (life.detail == life_.detail) {
    as_mapped_.TakePull(pull);
    return;
  }
  Asked& asked = asked_[life.detail];
  asked.last = now;
  if (asked.publisher) asked.publisher->TakePull(pull);
}

std::vector<PublishedMessage> LevelsPublisher::Tick(Clock::time_point now) {
  std::vector<PublishedMessage> messages;
  std::erase_if(asked_, [&](const auto& asked) { return now - asked.second.last > kLevelLease; });
  WorkOnLevels(now);
  Refill(now);
  // What is coarse is small and seen first.
  for (auto& [detail, asked] : asked_) {
    if (asked.publisher) asked.publisher->Tick(now, budget_, messages);
  }
  as_mapped_.Tick(now, budget_, messages);
  return messages;
}

std::vector<PublishedMessage> LevelsPublisher::LastTick(Clock::time_point now) {
  std::vector<PublishedMessage> messages;
  Refill(now);
  as_mapped_.LastTick(now, budget_, messages);
  return messages;
}

void LevelsPublisher::WorkOnLevels(Clock::time_point now) {
  const int wanted = asked_.empty() ? 0 : asked_.begin()->first.level;
  if (wanted == 0 || wanted > levels_.num_levels()) levels_ = LevelsOfDetail(wanted);
  if (wanted == 0) return;
  const bool is_new = levels_.Advance(layer_, kTilesPerTick);
  if (is_new) behind_since_.reset();
  if (!behind_since_ && levels_.IsAtWork(layer_)) behind_since_ = now;
  if (!levels_.HasLayers()) return;
  for (auto& [detail, asked] : asked_) {
    if (!asked.publisher) {
      asked.publisher = std::make_unique<LayerPublisher>(
          LayerLife{life_.id, life_.epoch, detail}, levels_.Layer(detail), map_options_, options_);
    } else if (is_new) {
      asked.publisher->SetLayer(levels_.Layer(detail), now);
    }
    asked.publisher->SetBehind(behind_since_);
  }
}

void LevelsPublisher::Refill(Clock::time_point now) {
  bool has_pulls = as_mapped_.HasPulls();
  for (const auto& [detail, asked] : asked_) {
    has_pulls |= asked.publisher && asked.publisher->HasPulls();
  }
  budget_.Refill(now, as_mapped_.HasChanges(), has_pulls);
}

}  // namespace splinemap
