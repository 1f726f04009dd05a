#include "lib/replication/pyramid_publisher.h"

#include <algorithm>
#include <chrono>
#include <utility>

#include "lcmtypes/splinemap/layer_pull_t.hpp"

namespace splinemap {
namespace {

// A level that nobody has asked for in this time is given up.
constexpr std::chrono::seconds kLevelLease(30);
// Tiles of coarser levels that are made in one tick, some milliseconds of work.
constexpr size_t kTilesPerTick = 200;

constexpr std::chrono::milliseconds kLayerPause(1);

PublisherOptions With(PublisherOptions options, bool sends_scans) {
  options.sends_scans = sends_scans;
  return options;
}

}  // namespace

PyramidPublisher::PyramidPublisher(const LayerSnapshot& layer, const MapOptions& map_options,
                                   const PublisherOptions& options, RecentScans* scans)
    : ref_{layer.id, layer.session, {}},
      map_options_(map_options),
      options_(With(options, options.sends_scans && options.pushes && layer.archive != nullptr)),
      layer_(layer),
      scans_(ref_, static_cast<int64_t>(options.proxy.value_or(ref_.session.nonce)), layer.revision,
             scans == nullptr ? own_scans_ : *scans, options_.sends_scans),
      as_mapped_(ref_, layer, map_options, options_) {}

void PyramidPublisher::AddScan(SentScan scan, Clock::time_point now) {
  if (!options_.sends_scans || scan.revision <= scans_.revision()) return;
  const uint64_t revision = scan.revision;
  own_scans_.Add(std::move(scan));
  scans_.SetRevision(revision, now);
}

void PyramidPublisher::SetLayer(const LayerSnapshot& layer, Clock::time_point now) {
  scans_.SetRevision(
      options_.sends_scans ? std::max(layer.revision, scans_.revision()) : layer.revision, now);
  layer_ = layer;
  as_mapped_.SetLayer(layer, now);
}

void PyramidPublisher::HandlePull(const layer_pull_t& pull, Clock::time_point now) {
  if (IsCall(pull)) {
    as_mapped_.HandlePull(pull, now);
    return;
  }
  const LayerRef ref = FromMessage(pull.layer);
  if (ref.id != ref_.id || ref.session != ref_.session || !ref.level_of_detail.IsValid()) {
    ++foreign_pulls_;
    return;
  }
  if (ref.level_of_detail == ref_.level_of_detail) {
    as_mapped_.HandlePull(pull, now);
    return;
  }
  Asked& asked = asked_[ref.level_of_detail];
  asked.last = now;
  if (asked.publisher) asked.publisher->HandlePull(pull, now);
}

void PyramidPublisher::HandleScanPull(const scan_pull_t& pull, Clock::time_point now) {
  const LayerRef ref = FromMessage(pull.layer);
  if (ref != ref_) {
    ++foreign_pulls_;
    return;
  }
  if (!options_.sends_scans && !options_.proxy) return;
  as_mapped_.HearScanPull(now);
  scans_.HandlePull(pull);
}

std::vector<ReplicationMessage> PyramidPublisher::Tick(Clock::time_point now, ByteBudget& budget) {
  std::vector<ReplicationMessage> messages;
  std::erase_if(asked_, [&](const auto& asked) { return now - asked.second.last > kLevelLease; });
  WorkOnLevels(now);
  // What is coarse is small and seen first.
  for (auto& [level_of_detail, asked] : asked_) {
    if (asked.publisher) asked.publisher->Tick(now, budget, messages);
  }
  // A session is known by its digest; and what a digest covers goes before it.
  if (!as_mapped_.HasDigested()) as_mapped_.Tick(now, budget, messages);
  SendScans(now, budget, messages);
  as_mapped_.Tick(now, budget, messages, /*may_digest=*/!IsBehind());
  return messages;
}

std::vector<ReplicationMessage> PyramidPublisher::LastTick(Clock::time_point now,
                                                           ByteBudget& budget) {
  std::vector<ReplicationMessage> messages;
  SendScans(now, budget, messages);
  as_mapped_.LastTick(now, budget, messages);
  return messages;
}

void PyramidPublisher::SendScans(Clock::time_point now, ByteBudget& budget,
                                 std::vector<ReplicationMessage>& messages) {
  scans_.Tick(now, budget, messages);
  if (options_.sends_scans) as_mapped_.SetBehind(scans_.waiting_since());
}

void PyramidPublisher::WorkOnLevels(Clock::time_point now) {
  const int wanted = asked_.empty() ? 0 : asked_.begin()->first.level;
  if (wanted == 0 || wanted > levels_.num_levels()) levels_ = LayerPyramid(wanted);
  if (wanted == 0) return;
  const bool is_new = levels_.Advance(layer_, kTilesPerTick);
  if (is_new) behind_since_.reset();
  if (!behind_since_ && levels_.IsAtWork(layer_)) behind_since_ = now;
  if (!levels_.HasLayers()) return;
  for (auto& [level_of_detail, asked] : asked_) {
    if (!asked.publisher) {
      asked.publisher =
          std::make_unique<LayerPublisher>(LayerRef{ref_.id, ref_.session, level_of_detail},
                                           levels_.Layer(level_of_detail), map_options_, options_);
    } else if (is_new) {
      asked.publisher->SetLayer(levels_.Layer(level_of_detail), now);
    }
    asked.publisher->SetBehind(behind_since_);
  }
}

bool PyramidPublisher::HasTilePulls() const {
  return as_mapped_.HasPulls() || std::any_of(asked_.begin(), asked_.end(), [](const auto& asked) {
           return asked.second.publisher && asked.second.publisher->HasPulls();
         });
}

Clock::time_point PyramidPublisher::NextTick(Clock::time_point now) const {
  const bool is_making_levels = !asked_.empty() && levels_.IsAtWork(layer_);
  const auto can_answer = [](const auto& asked) {
    return asked.second.publisher && asked.second.publisher->CanAnswer();
  };
  if (is_making_levels || as_mapped_.CanAnswer() ||
      std::any_of(asked_.begin(), asked_.end(), can_answer)) {
    return now;
  }
  Clock::time_point next = std::min(as_mapped_.NextTick(), scans_.NextTick());
  if (HasTilePulls()) next = std::min(next, now + ByteBudget::kPause);
  for (const auto& [level_of_detail, asked] : asked_) {
    next = std::min(next, asked.publisher ? asked.publisher->NextTick() : now);
  }
  // A digest that is due waits for the layer.
  return IsBehind() && !scans_.HasChanges() ? std::max(next, now + kLayerPause) : next;
}

}  // namespace splinemap
