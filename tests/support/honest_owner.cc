#include "tests/support/honest_owner.h"

#include "lib/map/layer_control.h"
#include "lib/map/tile_update.h"
#include "lib/wire/decode.h"
#include "tests/support/random_map.h"

namespace splinemap {

HonestOwner::HonestOwner(const std::string& name, const MapOptions& options, uint64_t seed)
    : options_(options), random_(seed), layer_(LayerId{name, random_()}, LayerEpoch{1, random_()}) {
  for (const TileKey key : {TileKey{0, 0}, TileKey{-1, 2}, TileKey{40, -3}}) {
    layer_.BeginCommit();
    layer_.EditTile(key) = RandomTile(random_, options_.limits);
  }
  Begin();
}

void HonestOwner::Remember() {
  truth_ = layer_.Snapshot();
  truth_.tiles.ForEach([&](TileKey key, const TileTree::Entry& entry) {
    mapped_.emplace(truth_.id, TileChecksum(key, *entry.tile));
  });
}

bool HonestOwner::HasMapped(const LayerId& id, const TileTree& tiles) const {
  bool all = true;
  tiles.ForEach([&](TileKey key, const TileTree::Entry& entry) {
    all = all && mapped_.contains({id, TileChecksum(key, *entry.tile)});
  });
  return all;
}

void HonestOwner::Begin() {
  Remember();
  PublisherOptions publisher;
  publisher.digest_interval = std::chrono::milliseconds(500);
  publisher_.emplace(truth_, options_, publisher);
}

void HonestOwner::Map(Clock::time_point now) {
  layer_.BeginCommit();
  layer_.EditTile(RandomKey(random_, 1)) = RandomTile(random_, options_.limits);
  Remember();
  publisher_->SetLayer(truth_, now);
}

void HonestOwner::GoOnAs(const LayerId& id, const LayerEpoch& epoch) {
  layer_.BeginLife(id, epoch);
  Begin();
}

void HonestOwner::Hear(absl::Span<const uint8_t> message, Clock::time_point now) {
  if (const auto digest = DecodeLayerDigest(message); digest.ok()) {
    identity_.TakeDigest(FromMessage(digest->layer), life(), now);
  } else if (const auto stand_in = DecodeStandInDigest(message); stand_in.ok()) {
    identity_.TakePull(FromMessage(stand_in->digest.layer), life(), now);
  } else if (const auto pull = DecodeLayerPull(message); pull.ok()) {
    identity_.TakePull(FromMessage(pull->layer), life(), now);
    publisher_->TakePull(*pull, now);
  } else if (const auto records = DecodeControlRecords(message); records.ok()) {
    for (const layer_control_t& record : records->records) {
      LayerControl control;
      control.removed_up_to = static_cast<uint64_t>(record.removed_up_to);
      const LayerId id{record.name, static_cast<uint64_t>(record.origin)};
      // As if somebody gave it a new file.
      if (id == life().id && control.IsValid() && control.IsRemoved(life().epoch)) {
        GoOnAs({id.name, random_()}, {1, random_()});
      }
    }
  }
}

std::vector<PublishedMessage> HonestOwner::Speak(Clock::time_point now) {
  if (const auto next = identity_.Next(life(), now, random_())) {
    GoOnAs(next->life.id, next->life.epoch);
  }
  return publisher_->Tick(now);
}

}  // namespace splinemap
