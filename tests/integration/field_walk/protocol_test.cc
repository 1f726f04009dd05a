// Every field of what owners, followers and those who decide say, to its extremes, on a bus of an
// honest owner, a follower that keeps layers as daemons do, and one that does not. In a time of its
// own.
#include <gtest/gtest.h>

#include <map>
#include <ostream>

#include "absl/strings/escaping.h"
#include "fmt/format.h"
#include "lib/following/map_follower.h"
#include "lib/replication/channels.h"
#include "lib/store/map_file.h"
#include "lib/wire/decode.h"
#include "lib/wire/encode.h"
#include "tests/integration/field_walk/variants.h"
#include "tests/support/honest_owner.h"
#include "tests/support/random_map.h"
#include "tests/support/temporary_directory.h"
#include "tests/support/valid_messages.h"

namespace splinemap::field_walk_protocol_test {

using std::chrono::milliseconds;
using std::chrono::seconds;
using Bytes = std::vector<uint8_t>;

constexpr MapOptions kOptions{0.05, {-2560, 2560}};

bool HaveSameTiles(const TileTree& a, const TileTree& b) {
  bool same = a.size() == b.size();
  a.ForEach([&](TileKey key, const TileTree::Entry& entry) {
    const Tile* other = b.Find(key);
    same = same && other != nullptr && *other == *entry.tile;
  });
  return same;
}

Keeper KeeperOptions(const LayerId& own) {
  Keeper keeper;
  keeper.map_options = kOptions;
  keeper.own_layer = own;
  keeper.daemon_nonce = 77;
  keeper.own_incarnation = 1;
  return keeper;
}

class World {
 public:
  World()
      : owner_("owner", kOptions, 1),
        keeper_({}, KeeperOptions(Kept()->layers[0].id), *Kept(), 2, now_),
        client_({}, 3) {
    keeper_.Decide(gone().id, keeper_.controls().Next(gone().id, 5));
    Run(seconds(10));
  }

  // The layer of the keeper, and one whose owner is silent.
  static const std::shared_ptr<const MapSnapshot>& Kept() {
    static const std::shared_ptr<const MapSnapshot> kKept = [] {
      std::mt19937_64 random(7);
      Map map(kOptions);
      for (const char* name : {"keeper", "gone"}) {
        Layer& layer = map.AddLayer({name, random()}, {1, random()});
        layer.BeginCommit();
        layer.EditTile({1, 1}) = RandomTile(random, kOptions.limits);
        layer.EditTile({2, -1}) = RandomTile(random, kOptions.limits);
      }
      map.SetOwnLayer(map.layers()[0].id());
      return map.Snapshot();
    }();
    return kKept;
  }
  static const LayerSnapshot& gone() { return Kept()->layers[1]; }

  // All talk, and the owner maps, for so long.
  void Run(milliseconds time, bool maps = true) {
    for (const auto end = now_ + time; now_ < end; now_ += milliseconds(50)) {
      if (maps && ++ticks_ % 10 == 0) owner_.Map(now_);
      if (ticks_ % 4 == 0) Deliver(RootPull());  // so that there are listings
      for (const PublishedMessage& said : owner_.Speak(now_)) {
        std::visit([&](const auto& m) { Say(m); }, said);
      }
      for (MapFollower* follower : {&keeper_, &client_}) {
        for (const MapFollower::Message& said : follower->Tick(now_)) {
          std::visit([&](const auto& m) { Say(m); }, said);
        }
      }
      for (const Bytes& message : std::exchange(said_, {})) Deliver(message);
    }
  }

  void Deliver(const Bytes& message) {
    owner_.Hear(message, now_);
    keeper_.HandleMessage(message, now_);
    client_.HandleMessage(message, now_);
  }

  // The last that was said of a layer; empty where nothing was.
  template <typename Message>
  Bytes Heard(const LayerId& id) const {
    const auto heard = heard_.find({ChannelOf(Message{}), id});
    return heard == heard_.end() ? Bytes() : heard->second;
  }

  Bytes RootPull() const {
    layer_pull_t pull;
    pull.layer = ToMessage(owner_.life());
    pull.num_nodes = 2;
    pull.levels = {1, 0};
    pull.xs = {0, 0};
    pull.ys = {0, 0};
    return Encode(pull);
  }

  Bytes Records(const LayerId& id) const {
    return ControlRecords(id, keeper_.controls().greatest_counter() + 1).bytes;
  }

  // What is wrong some time after the last hostile message; empty where nothing is.
  std::string WhatIsWrong(MapFile& file, const std::string& path) {
    Run(seconds(20));
    Run(seconds(4), /*maps=*/false);
    for (const auto& [who, follower] : {std::pair{"keeper", &keeper_}, {"client", &client_}}) {
      if (const std::string wrong = WhatIsFalse(*follower); !wrong.empty()) {
        return fmt::format("{}: {}", who, wrong);
      }
    }
    if (const std::string wrong = WhatIsUndecided(); !wrong.empty()) return wrong;
    return WhatIsUnreadable(file, path);
  }

  HonestOwner& owner() { return owner_; }

 private:
  template <typename Message>
  void Say(const Message& message) {
    said_.push_back(Encode(message));
    if constexpr (std::is_same_v<Message, control_records_t>) {
      heard_[{ChannelOf(message), LayerId{}}] = said_.back();
    } else if constexpr (std::is_same_v<Message, stand_in_digest_t>) {
      heard_[{ChannelOf(message), FromMessage(message.digest.layer).id}] = said_.back();
    } else {
      heard_[{ChannelOf(message), FromMessage(message.layer).id}] = said_.back();
    }
  }

  // Where it says that a layer is in sync, it has what its owner published; and the layer of an
  // owner that is there is in sync.
  std::string WhatIsFalse(MapFollower& follower) {
    bool has_owners = false;
    const std::vector<LayerSnapshot> shown = follower.LayerSnapshots();
    for (const FollowedLayer& layer : follower.Layers(now_)) {
      const auto snapshot = std::find_if(shown.begin(), shown.end(),
                                         [&](const auto& other) { return other.id == layer.id; });
      const bool is_owners = layer.id == owner_.life().id;
      has_owners |= is_owners;
      if (is_owners && (!layer.in_sync || layer.owner_is_silent)) {
        return "the layer of an owner that speaks is not live";
      }
      if (!layer.in_sync) continue;
      if (is_owners               ? !HaveSameTiles(snapshot->tiles, owner_.truth().tiles)
          : layer.id == gone().id ? !HaveSameTiles(snapshot->tiles, gone().tiles)
                                  : !owner_.HasMapped(layer.id, snapshot->tiles)) {
        return fmt::format(
            "layer {} of {} tiles is said to be in sync, and its owner never "
            "published that",
            absl::CHexEscape(layer.id.name.substr(0, 20)), snapshot->tiles.size());
      }
    }
    return has_owners ? "" : "the layer of an owner that speaks is not followed";
  }

  // What somebody decides now holds for all.
  std::string WhatIsUndecided() {
    const LayerId id = owner_.life().id;
    for (const bool muted : {true, false}) {
      LayerControl control = keeper_.controls().Next(id, 77);
      control.muted = muted;
      keeper_.Decide(id, control);
      Run(seconds(4), /*maps=*/false);
      if (keeper_.controls().Of(id).muted != muted) return "no decision can be made";
      if (client_.controls().Of(id).muted != muted) return "a decision does not reach the client";
    }
    return "";
  }

  std::string WhatIsUnreadable(MapFile& file, const std::string& path) {
    MapSnapshot map;
    map.options = kOptions;
    map.own_layer = Kept()->layers[0].id;
    map.layers = keeper_.LayerSnapshots();
    map.layers.insert(map.layers.begin(), Kept()->layers[0]);
    map.controls = keeper_.controls();
    const auto left_out = file.Save(map);
    if (!left_out.ok()) return std::string(left_out.status().message());
    if (!left_out->empty()) return left_out->front();
    const auto loaded = ReadMapFile(path);
    if (!loaded.ok()) return std::string(loaded.status().message());
    if (!loaded->damages.empty()) return loaded->damages[0];
    if (loaded->map->controls != map.controls) return "the file has other decisions";
    if (loaded->map->layers.size() != map.layers.size()) return "the file has other layers";
    for (const LayerSnapshot& layer : map.layers) {
      const auto saved =
          std::find_if(loaded->map->layers.begin(), loaded->map->layers.end(),
                       [&](const LayerSnapshot& other) { return other.id == layer.id; });
      if (saved == loaded->map->layers.end() || saved->epoch != layer.epoch ||
          saved->revision != layer.revision || !HaveSameTiles(saved->tiles, layer.tiles)) {
        return "the file has another layer";
      }
    }
    return "";
  }

  Clock::time_point now_{std::chrono::hours(1)};
  HonestOwner owner_;
  MapFollower keeper_;
  MapFollower client_;
  int ticks_ = 0;
  std::vector<Bytes> said_;
  std::map<std::pair<std::string, LayerId>, Bytes> heard_;
};

using MakeMessage = Bytes (*)(World&);

struct Walk {
  const char* name;
  MakeMessage make;  // a valid message of the moment
};

void PrintTo(const Walk& walk, std::ostream* out) { *out << walk.name; }

class ProtocolWalkTest : public testing::TestWithParam<Walk> {};

TEST_P(ProtocolWalkTest, NoFieldHarmsWhatFollowersHaveAndSay) {
  const TemporaryDirectory directory;
  const std::string path = directory.File("map");
  auto file = MapFile::Open(path);
  ASSERT_TRUE(file.ok()) << file.status();
  World first;
  ASSERT_EQ(first.WhatIsWrong(*file, path), "");
  const Bytes example = GetParam().make(first);
  ASSERT_FALSE(example.empty());
  const LcmValue parsed = Types().Parse(TypeNameOf(example), example);
  ASSERT_EQ(Encode(parsed), example);
  const std::vector<Variant> variants = VariantsOf(parsed);
  Tally(GetParam().name).Add(variants);
  const auto run = [&](absl::Span<const Variant> some) {
    World world;
    for (const Variant& variant : some) {
      const Bytes message = GetParam().make(world);
      world.Deliver(Apply(variant, Types().Parse(TypeNameOf(message), message)));
      world.Run(milliseconds(200));
    }
    return world.WhatIsWrong(*file, path);
  };
  for (const std::string& culprit : FindCulprits(variants, 64, run)) ADD_FAILURE() << culprit;
}

INSTANTIATE_TEST_SUITE_P(
    , ProtocolWalkTest,
    testing::Values(
        Walk{"Digest", [](World& w) { return w.Heard<layer_digest_t>(w.owner().life().id); }},
        Walk{"DigestOfASilentOwner",
             [](World& w) {
               const auto said = DecodeStandInDigest(w.Heard<stand_in_digest_t>(World::gone().id));
               return said.ok() ? Encode(said->digest) : Bytes();
             }},
        Walk{"StandInDigest",
             [](World& w) { return w.Heard<stand_in_digest_t>(World::gone().id); }},
        Walk{"Updates", [](World& w) { return FalseUpdates(w.owner().truth(), 100).bytes; }},
        Walk{"UpdatesBeyondTheClamps",
             [](World& w) { return FalseUpdates(w.owner().truth(), 3000).bytes; }},
        Walk{"UpdatesOfASilentOwner",
             [](World&) { return FalseUpdates(World::gone(), 100).bytes; }},
        Walk{"Listing", [](World& w) { return w.Heard<layer_listing_t>(w.owner().life().id); }},
        Walk{"Pull", [](World& w) { return w.RootPull(); }},
        Walk{"ControlRecords", [](World& w) { return w.Records(w.owner().life().id); }},
        Walk{"ControlRecordsOfNobody",
             [](World& w) {
               return w.Records({"nobody", 1});
             }}),
    [](const auto& walk) { return walk.param.name; });

}  // namespace splinemap::field_walk_protocol_test
