// Every field of what owners, followers and those who change settings say, to its extremes, on a
// bus of an honest owner, a follower that keeps layers as daemons do, and one that does not. In a
// time of its own.
#include <gtest/gtest.h>

#include <map>
#include <ostream>
#include <tuple>

#include "absl/strings/escaping.h"
#include "fmt/format.h"
#include "lcmtypes/splinemap/layer_digest_t.hpp"
#include "lcmtypes/splinemap/layer_listing_t.hpp"
#include "lcmtypes/splinemap/layer_pull_t.hpp"
#include "lcmtypes/splinemap/scan_pull_t.hpp"
#include "lcmtypes/splinemap/settings_t.hpp"
#include "lib/replication/map_follower.h"
#include "lib/wire/decode.h"
#include "lib/wire/encode.h"
#include "splinemap/file.h"
#include "tests/integration/field_walk/variants.h"
#include "tests/support/honest_owner.h"
#include "tests/support/map_writer.h"
#include "tests/support/random_map.h"
#include "tests/support/temporary_directory.h"
#include "tests/support/valid_messages.h"

namespace splinemap::field_walk_protocol_test {

using std::chrono::milliseconds;
using std::chrono::seconds;
using Bytes = std::vector<uint8_t>;

constexpr MapOptions kOptions{0.05, {-2560, 2560}};
constexpr int64_t kSomebody = 99;

bool HaveSameTiles(const TileTree& a, const TileTree& b) {
  bool same = a.size() == b.size();
  a.ForEach([&](TileKey key, const TileTree::Entry& entry) {
    const StoredTile* other = b.Find(key);
    same = same && other != nullptr && HaveEqualContent(*other, *entry.tile);
  });
  return same;
}

KeeperOptions OptionsOf(const LayerId& own) {
  KeeperOptions keeper;
  keeper.map_options = kOptions;
  keeper.own_layer = own;
  keeper.own_session_number = 1;
  return keeper;
}

class World {
 public:
  explicit World(bool maps_scans)
      : owner_("owner", kOptions, 1, maps_scans),
        keeper_({}, OptionsOf(Kept().layers[0].id), Kept(), 77, now_),
        client_({}, 3) {
    keeper_.Set(gone().id, keeper_.settings().Next(gone().id, 5));
    Run(seconds(10));
  }

  // The layer of the keeper, and one whose owner is silent.
  static const LayerSet& Kept() {
    static const LayerSet kKept = [] {
      std::mt19937_64 random(7);
      MapWriter map(kOptions);
      for (const char* name : {"keeper", "gone"}) {
        Layer& layer = map.AddLayer({name, random()}, {1, random()});
        layer.BeginCommit();
        layer.EditTile({1, 1}) = RandomTile(random, kOptions.limits);
        layer.EditTile({2, -1}) = RandomTile(random, kOptions.limits);
      }
      map.SetOwnLayer(map.layers()[0].id());
      return map.Layers();
    }();
    return kKept;
  }
  static const LayerSnapshot& gone() { return Kept().layers[1]; }

  // All talk, and the owner maps, for so long.
  void Run(milliseconds time, bool maps = true) {
    for (const auto end = now_ + time; now_ < end; now_ += milliseconds(50)) {
      if (maps && ++ticks_ % 10 == 0) owner_.Map(now_);
      if (ticks_ % 4 == 0) Deliver(RootPull());  // so that there are listings
      for (const ReplicationMessage& said : owner_.Speak(now_)) Say(said);
      for (const auto& [follower, budget] :
           {std::pair{&keeper_, &keepers_budget_}, {&client_, &clients_budget_}}) {
        budget->Refill(now_, false, follower->HasPulls());
        for (const ReplicationMessage& said : follower->Tick(now_, *budget)) Say(said);
      }
      for (const Bytes& message : std::exchange(said_, {})) Deliver(message);
    }
  }

  void Deliver(const Bytes& message) {
    owner_.Hear(message, now_);
    keeper_.HandleBytes(message, now_);
    client_.HandleBytes(message, now_);
  }

  // The last that its owner, or a proxy, said of a layer; empty where nothing was.
  template <typename Message>
  Bytes Heard(const LayerId& id, bool is_owners = true) const {
    const auto heard = heard_.find({ChannelOf(Message{}, ""), id, is_owners});
    return heard == heard_.end() ? Bytes() : heard->second;
  }

  Bytes RootPull() const {
    layer_pull_t pull;
    pull.speaker = kSomebody;
    pull.layer = ToMessage(owner_.ref());
    pull.num_nodes = 2;
    pull.levels = {1, 0};
    pull.xs = {0, 0};
    pull.ys = {0, 0};
    return Encode(pull);
  }

  Bytes ScanPull() const {
    scan_pull_t pull{};
    pull.speaker = kSomebody;
    pull.layer = ToMessage(owner_.ref());
    pull.num_ranges = 1;
    pull.first = {static_cast<int64_t>(owner_.truth().revision)};
    pull.last = pull.first;
    return Encode(pull);
  }

  Bytes Settings(const LayerId& id) const {
    return SettingsMessage(id, keeper_.settings().greatest_counter() + 1).bytes;
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
    if (const std::string wrong = WhatIsNotSet(); !wrong.empty()) return wrong;
    return WhatIsUnreadable(file, path);
  }

  HonestOwner& owner() { return owner_; }

 private:
  void Say(const ReplicationMessage& message) {
    said_.push_back(EncodeReplication(message));
    const auto remember = [&](const auto& said) {
      if constexpr (requires { said.layer; }) {
        const LayerRef ref = FromMessage(said.layer);
        const bool is_owners = SpeakerOf(message) == ref.session.nonce;
        heard_[{ChannelOf(message, ""), ref.id, is_owners}] = said_.back();
      }
    };
    std::visit(remember, message);
  }

  // Where it says that a layer is caught up, it has what its owner published; and the layer of an
  // owner that is there is caught up.
  std::string WhatIsFalse(MapFollower& follower) {
    bool has_owners = false;
    const LayerSet shown = follower.Layers();
    for (const FollowedLayer& layer : follower.FollowedLayers(now_)) {
      const LayerSnapshot* snapshot = shown.Find(layer.id);
      const bool is_owners = layer.id == owner_.ref().id;
      has_owners |= is_owners;
      if (is_owners && (!layer.caught_up || layer.owner_is_silent)) {
        return "the layer of an owner that speaks is not live";
      }
      if (!layer.caught_up) continue;
      if (is_owners               ? !HaveSameTiles(snapshot->tiles, owner_.truth().tiles)
          : layer.id == gone().id ? !HaveSameTiles(snapshot->tiles, gone().tiles)
                                  : !owner_.HasMapped(layer.id, snapshot->tiles)) {
        return fmt::format(
            "layer {} of {} tiles is said to be caught up, and its owner never "
            "published that",
            absl::CHexEscape(layer.id.name.substr(0, 20)), snapshot->tiles.size());
      }
    }
    return has_owners ? "" : "the layer of an owner that speaks is not followed";
  }

  // What somebody sets now holds for all.
  std::string WhatIsNotSet() {
    const LayerId id = owner_.ref().id;
    for (const bool muted : {true, false}) {
      LayerSettings setting = keeper_.settings().Next(id, 77);
      setting.muted = muted;
      keeper_.Set(id, setting);
      Run(seconds(4), /*maps=*/false);
      if (keeper_.settings().Of(id).muted != muted) return "no setting can be changed";
      if (client_.settings().Of(id).muted != muted) return "a setting does not reach the client";
    }
    return "";
  }

  std::string WhatIsUnreadable(MapFile& file, const std::string& path) {
    LayerSet set = keeper_.Layers();
    set.own_layer = Kept().layers[0].id;
    set.layers.insert(set.layers.begin(), Kept().layers[0]);
    const auto left_out = file.Save(set);
    if (!left_out.ok()) return std::string(left_out.status().message());
    if (!left_out->empty()) return left_out->front();
    const auto loaded = ReadMapFile(path);
    if (!loaded.ok()) return std::string(loaded.status().message());
    if (!loaded->corruption.empty()) return loaded->corruption[0];
    if (loaded->set.settings != set.settings) return "the file has other settings";
    if (loaded->set.layers.size() != set.layers.size()) return "the file has other layers";
    for (const LayerSnapshot& layer : set.layers) {
      const LayerSnapshot* saved = loaded->set.Find(layer.id);
      if (saved == nullptr || saved->session != layer.session ||
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
  ByteBudget keepers_budget_{PublisherOptions().bytes_per_s};
  ByteBudget clients_budget_{PublisherOptions().bytes_per_s};
  int ticks_ = 0;
  std::vector<Bytes> said_;
  std::map<std::tuple<std::string, LayerId, bool>, Bytes> heard_;  // by channel, layer, whose
};

using MakeMessage = Bytes (*)(World&);

struct Walk {
  const char* name;
  MakeMessage make;         // a valid message of the moment
  bool maps_scans = false;  // the owner
};

void PrintTo(const Walk& walk, std::ostream* out) { *out << walk.name; }

class ProtocolWalkTest : public testing::TestWithParam<Walk> {};

TEST_P(ProtocolWalkTest, NoFieldHarmsWhatFollowersHaveAndSay) {
  const TemporaryDirectory directory;
  const std::string path = directory.File("map");
  auto file = MapFile::Open(path);
  ASSERT_TRUE(file.ok()) << file.status();
  World first(GetParam().maps_scans);
  ASSERT_EQ(first.WhatIsWrong(*file, path), "");
  const Bytes example = GetParam().make(first);
  ASSERT_FALSE(example.empty());
  const LcmValue parsed = Types().Parse(TypeNameOf(example), example);
  ASSERT_EQ(Encode(parsed), example);
  const std::vector<Variant> variants = VariantsOf(parsed);
  Tally(GetParam().name).Add(variants);
  const auto run = [&](absl::Span<const Variant> some) {
    World world(GetParam().maps_scans);
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
        Walk{"Digest", [](World& w) { return w.Heard<layer_digest_t>(w.owner().ref().id); }},
        Walk{"DigestOfASilentOwner",
             [](World& w) {
               auto said = Decode<layer_digest_t>(
                   w.Heard<layer_digest_t>(World::gone().id, /*is_owners=*/false));
               if (!said.ok()) return Bytes();
               said->speaker = said->layer.session_nonce;
               return Encode(*said);
             }},
        Walk{"DigestOfAProxy",
             [](World& w) {
               return w.Heard<layer_digest_t>(World::gone().id, /*is_owners=*/false);
             }},
        Walk{"Updates", [](World& w) { return FalseUpdates(w.owner().truth(), 100).bytes; }},
        Walk{"UpdatesBeyondTheClamps",
             [](World& w) { return FalseUpdates(w.owner().truth(), 3000).bytes; }},
        Walk{"UpdatesOfASilentOwner",
             [](World&) { return FalseUpdates(World::gone(), 100).bytes; }},
        Walk{"Scan", [](World& w) { return FalseScan(w.owner().truth()).bytes; }, true},
        Walk{"ScanOfASilentOwner", [](World&) { return FalseScan(World::gone()).bytes; }},
        Walk{"ScanPull", [](World& w) { return w.ScanPull(); }, true},
        Walk{"DigestBesideScans",
             [](World& w) { return w.Heard<layer_digest_t>(w.owner().ref().id); }, true},
        Walk{"Listing", [](World& w) { return w.Heard<layer_listing_t>(w.owner().ref().id); }},
        Walk{"Pull", [](World& w) { return w.RootPull(); }},
        Walk{"Settings", [](World& w) { return w.Settings(w.owner().ref().id); }},
        Walk{"SettingsOfNobody",
             [](World& w) {
               return w.Settings({"nobody", 1});
             }}),
    [](const auto& walk) { return walk.param.name; });

}  // namespace splinemap::field_walk_protocol_test
