#include "tests/support/honest_owner.h"

#include "lcmtypes/splinemap/layer_digest_t.hpp"
#include "lcmtypes/splinemap/layer_pull_t.hpp"
#include "lcmtypes/splinemap/layer_settings_t.hpp"
#include "lcmtypes/splinemap/scan_pull_t.hpp"
#include "lcmtypes/splinemap/settings_t.hpp"
#include "lib/tiles/tile_codec.h"
#include "splinemap/layer_settings.h"
#include "tests/support/random_map.h"

namespace splinemap {

HonestOwner::HonestOwner(const std::string& name, const MapOptions& options, uint64_t seed,
                         bool maps_scans)
    : options_(options), random_(seed), layer_(LayerId{name, random_()}, SessionId{1, random_()}) {
  if (maps_scans) mapper_.emplace(std::make_shared<ScanFolder>(options));
  for (const TileKey key : {TileKey{0, 0}, TileKey{-1, 2}, TileKey{40, -3}}) {
    layer_.BeginCommit();
    layer_.EditTile(key) = RandomTile(random_, options_.limits);
  }
  Begin();
}

void HonestOwner::Remember() {
  truth_ = mapper_ ? mapper_->SnapshotOf(layer_) : layer_.Snapshot();
  truth_.tiles.ForEach([&](TileKey key, const TileTree::Entry& entry) {
    mapped_.emplace(truth_.id, TileChecksum(key, *entry.tile->Get()));
  });
}

bool HonestOwner::HasMapped(const LayerId& id, const TileTree& tiles) const {
  bool all = true;
  tiles.ForEach([&](TileKey key, const TileTree::Entry& entry) {
    all = all && mapped_.contains({id, TileChecksum(key, *entry.tile->Get())});
  });
  return all;
}

void HonestOwner::Begin() {
  Remember();
  PublisherOptions publisher;
  publisher.digest_interval = std::chrono::milliseconds(500);
  publisher_.emplace(truth_, options_, publisher);
  budget_.emplace(publisher.bytes_per_s);
}

void HonestOwner::Map(Clock::time_point now) {
  if (mapper_) {
    const PosedScan scan = RandomScan(random_, 1.6);
    publisher_->AddScan(ScanMapper::SentOf(scan, layer_), now);
    mapper_->Map(scan, layer_);
  } else {
    layer_.BeginCommit();
    layer_.EditTile(RandomKey(random_, 1)) = RandomTile(random_, options_.limits);
  }
  Remember();
  publisher_->SetLayer(truth_, now);
}

void HonestOwner::GoOnAs(const LayerId& id, const SessionId& session) {
  layer_.StartSession(id, session);
  Begin();
}

void HonestOwner::Hear(absl::Span<const uint8_t> bytes, Clock::time_point now) {
  const auto message = DecodeReplication(bytes);
  if (!message.ok() || SpeakerOf(*message) == truth_.session.nonce) return;
  if (const auto* digest = std::get_if<layer_digest_t>(&*message)) {
    if (IsOwners(*digest)) {
      guard_.HandleDigest(FromMessage(digest->layer), ref(), now);
    } else {
      guard_.HandleKnown(FromMessage(digest->layer), ref(), now);
    }
  } else if (const auto* pull = std::get_if<layer_pull_t>(&*message)) {
    guard_.HandleKnown(FromMessage(pull->layer), ref(), now);
    publisher_->HandlePull(*pull, now);
  } else if (const auto* scans = std::get_if<scan_pull_t>(&*message)) {
    publisher_->HandleScanPull(*scans, now);
  } else if (const auto* settings = std::get_if<settings_t>(&*message)) {
    for (const layer_settings_t& layer : settings->layers) {
      LayerSettings setting;
      setting.removed_up_to = static_cast<uint64_t>(layer.removed_up_to);
      const LayerId id{layer.name, static_cast<uint64_t>(layer.origin)};
      // As if somebody gave it a new file.
      if (id == ref().id && setting.IsValid() && setting.IsRemoved(ref().session)) {
        GoOnAs({id.name, random_()}, {1, random_()});
      }
    }
  }
}

std::vector<ReplicationMessage> HonestOwner::Speak(Clock::time_point now) {
  if (const auto next = guard_.Next(ref(), now, random_())) {
    GoOnAs(next->ref.id, next->ref.session);
  }
  budget_->Refill(now, publisher_->HasChanges(), publisher_->HasPulls());
  return publisher_->Tick(now, *budget_);
}

}  // namespace splinemap
