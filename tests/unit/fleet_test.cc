// Several daemons and clients on one lossy network: whatever was lost, whoever was away, began from
// older files or was muted, placed or removed meanwhile, all end with the same bytes. Daemons are
// their parts without threads, sockets and disks. Time is virtual.
#include <gtest/gtest.h>

#include <algorithm>
#include <cstdlib>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "fmt/format.h"
#include "lcmtypes/splinemap/layer_digest_t.hpp"
#include "lcmtypes/splinemap/layer_pull_t.hpp"
#include "lib/map/summed_layers.h"
#include "lib/replication/layer_exchange.h"
#include "lib/replication/map_follower.h"
#include "lib/tiles/tile_codec.h"
#include "lib/wire/decode.h"
#include "splinemap/layer_set.h"
#include "tests/support/lossy_network.h"
#include "tests/support/map_writer.h"
#include "tests/support/num_schedules.h"
#include "tests/support/placement.h"
#include "tests/support/random_map.h"
#include "tests/support/scan_mapper.h"
#include "tests/support/test_keys.h"

namespace splinemap::fleet_test {

using std::chrono::milliseconds;
using Random = std::mt19937_64;

constexpr MapOptions kOptions{0.05, {-2560, 2560}};

// What copies of a map are compared by: sessions and content of layers with tiles, settings, sum.
struct Content {
  std::map<LayerId, std::pair<SessionId, uint64_t>> layers;
  std::map<LayerId, LayerSettings> settings;
  uint64_t sum = 0;

  bool operator==(const Content&) const = default;
};

uint64_t HashOf(const TileTree& tiles) {
  uint64_t hash = 0;
  tiles.ForEach([&](TileKey key, const TileTree::Entry& entry) {
    const auto tile = entry.tile->Get();
    if (CountTouched(*tile) > 0) hash += TileChecksum(key, *tile);
  });
  return hash;
}

Content ContentOf(const LayerSet& set, const MapView& view) {
  Content content;
  content.settings = set.settings.records();
  content.sum = HashOf(view.tiles);
  for (const LayerSnapshot& layer : set.layers) {
    if (layer.tiles.size() == 0) continue;
    content.layers[layer.id] = {layer.session, HashOf(layer.tiles)};
  }
  return content;
}

Content ContentOf(MapFollower& follower) { return ContentOf(follower.Layers(), *follower.View()); }

// Of all robots: it takes some time to make.
std::shared_ptr<ScanFolder> Folder() {
  static const auto& folder =
      *new std::shared_ptr<ScanFolder>(std::make_shared<ScanFolder>(kOptions));
  return folder;
}

class Robot {
 public:
  // Maps scans and keeps them, or has tiles from elsewhere.
  Robot(std::string name, bool has_scans, Random& random) : random_(random), has_scans_(has_scans) {
    file_.options = kOptions;
    file_.own_layer = LayerId{std::move(name), random_()};
  }

  // Before it is started.
  void SetKeys(std::shared_ptr<const KeyRing> keys) { keys_ = std::move(keys); }
  bool is_running() const { return map_ != nullptr; }
  const LayerId& id() const { return *file_.own_layer; }

  void Start(Clock::time_point now) {
    map_ = std::make_unique<MapWriter>(kOptions);
    const auto own = std::find_if(file_.layers.begin(), file_.layers.end(),
                                  [&](const LayerSnapshot& layer) { return layer.id == id(); });
    if (own == file_.layers.end()) {
      layer_ = &map_->AddLayer(id(), {1, random_()});
    } else {
      const SessionId session{own->session.number + 1, random_()};
      const LayerSettings& setting = file_.settings.Of(id());
      layer_ = setting.IsRemoved(session)
                   ? &map_->AddLayer(id(), {setting.removed_up_to + 1, random_()})
                   : &map_->ContinueLayer(*own, session);
    }
    mapper_.emplace(Folder());
    FollowOptions follow;
    follow.keys = keys_;
    exchange_ = std::make_unique<LayerExchange>(follow, PublisherOptions{}, Own(), file_, now);
    Save();  // the new session
  }
  void Stop() {
    is_leaving_ = false;
    map_.reset();
    exchange_.reset();
  }
  void Save() {
    files_.push_back(file_);
    file_ = Layers();
  }
  // The disk as it was some saves ago.
  void RestoreOlderFile() {
    if (!files_.empty()) file_ = files_[random_() % files_.size()];
  }

  void Commit(int tiles = 3) {
    if (has_scans_) {
      const PosedScan scan = RandomScan(random_, 1.6 * 4);
      said_.emplace_back(layer_->session(), ScanMapper::SentOf(scan, *layer_));
      mapper_->Map(scan, *layer_);
      return;
    }
    layer_->BeginCommit();
    for (int n = 0; n < tiles; ++n) {
      Tile& tile = layer_->EditTile(RandomKey(random_, 4));
      for (int k = 0; k < 20; ++k) {
        tile.control_points[random_() % Tile::kSize] =
            static_cast<ControlPoint>(int(random_() % 5121) - 2560);
      }
    }
  }

  // As after its scans were corrected: other tiles in place of those that were there, of which most
  // stay.
  void Refold() {
    const LayerSnapshot before = layer_->Snapshot();
    TileTreeEditor tiles;
    before.tiles.ForEach([&](TileKey key, const TileTree::Entry& entry) {
      if (random_() % 4 != 0) tiles.Put(key, entry.tile, entry.revision);
    });
    tiles.Edit(RandomKey(random_, 4), before.revision + 1).Edit().control_points.fill(7);
    layer_->ReplaceTiles({before.session.number + 1, before.session.nonce}, tiles.Freeze());
    Save();
  }

  // What a person may tell a daemon about a layer.
  void SetSomething() {
    const LayerSet set = Layers();
    const LayerId id = set.layers[random_() % set.layers.size()].id;
    const auto change = [&](const SessionId& session, LayerSettings& settings) {
      switch (random_() % 5) {
        case 0:
          settings.Remove(session);
          break;
        case 1:
          settings.low_weight = !settings.low_weight;
          break;
        case 2:
          settings.placement = ShiftBy(int32_t(random_() % 100) - 50, int32_t(random_() % 64));
          if (random_() % 2 == 0) settings.placement.yaw = static_cast<int32_t>(random_());
          break;
        default:
          settings.muted = !settings.muted;
      }
      return absl::OkStatus();
    };
    EXPECT_TRUE(exchange_->Edit(id, change).ok());
  }

  void HandleMessage(const std::vector<uint8_t>& bytes, Clock::time_point now) {
    exchange_->HandleBytes(bytes, now);
  }

  std::vector<std::vector<uint8_t>> Tick(Clock::time_point now) {
    const auto next = exchange_->NextSession(now, random_());
    const bool is_removed = exchange_->IsOwnRemoved();
    if (is_removed) {
      const uint64_t removed_up_to = exchange_->follower().settings().Of(id()).removed_up_to;
      layer_->StartEmptySession({removed_up_to + 1, layer_->session().nonce});
    } else if (next) {
      layer_->StartSession(next->ref.id, next->ref.session);
      file_.own_layer = next->ref.id;
    }
    for (auto& [session, scan] : std::exchange(said_, {})) {
      exchange_->AddOwnScan(session, std::move(scan), now);
    }
    exchange_->SetOwn(Own(), now);
    if (next && !is_removed) Save();
    return Encoded(is_leaving_ ? exchange_->LastTick(now) : exchange_->Tick(now));
  }
  // As daemons do that are stopped.
  void BeginToLeave() { is_leaving_ = true; }
  bool IsKnown(Clock::time_point now) const { return exchange_->IsOwnKnown(now); }

  LayerSet Layers() {
    LayerSet set = exchange_->FollowedLayers();
    set.options = kOptions;
    set.own_layer = layer_->id();
    set.layers.push_back(Own());
    return set;
  }
  Content Map() {
    const LayerSet set = Layers();
    return ContentOf(set, *ViewOf(set));
  }

 private:
  std::vector<std::vector<uint8_t>> Encoded(const std::vector<ReplicationMessage>& messages) const {
    std::vector<std::vector<uint8_t>> bytes;
    for (const ReplicationMessage& message : messages) {
      bytes.push_back(SignedMessage(keys_.get(), message));
    }
    return bytes;
  }

  LayerSnapshot Own() { return has_scans_ ? mapper_->SnapshotOf(*layer_) : layer_->Snapshot(); }

  Random& random_;
  const bool has_scans_;
  std::shared_ptr<const KeyRing> keys_;
  std::optional<ScanMapper> mapper_;
  std::vector<std::pair<SessionId, SentScan>> said_;  // since the last Tick()
  bool is_leaving_ = false;
  LayerSet file_;
  std::vector<LayerSet> files_;
  std::unique_ptr<MapWriter> map_;
  Layer* layer_ = nullptr;
  std::unique_ptr<LayerExchange> exchange_;
};

// Follows, and keeps nothing.
struct Client {
  Client(uint64_t speaker, std::shared_ptr<const KeyRing> its_keys)
      : keys(std::move(its_keys)), follower(Options(speaker, keys), speaker) {}

  // One in three takes tiles.
  static FollowOptions Options(uint64_t speaker, std::shared_ptr<const KeyRing> keys) {
    FollowOptions options;
    options.keys = std::move(keys);
    options.takes_tiles = speaker % 3 == 0;
    return options;
  }

  std::shared_ptr<const KeyRing> keys;
  MapFollower follower;
  ByteBudget budget{PublisherOptions().bytes_per_s};
};

class Fleet {
 public:
  Fleet(Weather weather, int robots, int clients, uint64_t seed)
      : network_(weather, seed), random_(seed) {
    for (int n = 0; n < robots; ++n) {
      robots_.push_back(
          std::make_unique<Robot>("robot-" + std::to_string(n), (seed + n) % 4 != 0, random_));
    }
    for (int n = 0; n < clients; ++n) RestartClient(clients_.size());
  }

  // Before anybody is started: all sign, and a stranger sends recorded and forged messages.
  void UseKeys() {
    has_keys_ = true;
    for (size_t n = 0; n < robots_.size(); ++n) robots_[n]->SetKeys(KeysOf(n));
    for (size_t n = 0; n < clients_.size(); ++n) RestartClient(n);
  }

  Network& network() { return network_; }
  Random& random() { return random_; }
  size_t num_robots() const { return robots_.size(); }
  Robot& robot(size_t n) { return *robots_[n]; }
  void Start(size_t n) {
    if (!robots_[n]->is_running()) robots_[n]->Start(network_.now());
  }
  void StartAll() {
    for (size_t n = 0; n < robots_.size(); ++n) Start(n);
  }
  // Its last changes are still to be published. Returns how long it takes.
  milliseconds Leave(size_t n, milliseconds at_most) {
    Robot& robot = *robots_[n];
    robot.BeginToLeave();
    milliseconds taken(0);
    do {
      Run(milliseconds(50));
      taken += milliseconds(50);
    } while (!robot.IsKnown(network_.now()) && taken < at_most);
    robot.Stop();
    return taken;
  }
  void RestartClient(size_t n) {
    if (n == clients_.size()) clients_.emplace_back();
    clients_[n] = std::make_shared<Client>(random_(), KeysOf(robots_.size()));
  }
  MapFollower& client(size_t n) { return clients_[n]->follower; }
  size_t num_clients() const { return clients_.size(); }
  int64_t bytes_sent() const { return bytes_sent_; }
  // By all that are proxies of others.
  int64_t proxy_digests() const { return proxy_digests_; }

  void Run(milliseconds duration) {
    for (milliseconds passed(0); passed < duration; passed += Network::kStep) {
      network_.Advance();
      const auto now = network_.now();
      for (const auto& robot : robots_) {
        if (!robot->is_running()) continue;
        for (const auto& bytes : robot->Tick(now)) Broadcast(bytes);
      }
      for (const auto& client : clients_) {
        client->budget.Refill(now, false, client->follower.HasPulls());
        for (const auto& message : client->follower.Tick(now, client->budget)) {
          Broadcast(SignedMessage(client->keys.get(), message));
        }
      }
      if (has_keys_) SpeakAsStranger();
    }
  }

  bool AllAreEqual() { return !DifferenceFrom(AnyContent()).has_value(); }
  // Who has another map than that.
  std::optional<std::string> DifferenceFrom(const Content& content) {
    for (const auto& robot : robots_) {
      if (robot->is_running() && robot->Map() != content) return robot->id().name;
    }
    for (size_t n = 0; n < clients_.size(); ++n) {
      if (ContentOf(client(n)) != content) return "client " + std::to_string(n);
    }
    return std::nullopt;
  }
  Content AnyContent() {
    for (const auto& robot : robots_) {
      if (robot->is_running()) return robot->Map();
    }
    return ContentOf(client(0));
  }
  // For people.
  std::string Contents() {
    std::string text;
    const auto add = [&](const std::string& name, const Content& content) {
      text += fmt::format("{}: sum {:x}\n", name, content.sum);
      for (const auto& [id, layer] : content.layers) {
        text += fmt::format("  {} {:x}: session {}, nonce {:x}, hash {:x}\n", id.name, id.origin,
                            layer.first.number, layer.first.nonce, layer.second);
      }
      for (const auto& [id, setting] : content.settings) {
        text += fmt::format("  {} {:x}: counter {}, writer {:x}, removed up to {}\n", id.name,
                            id.origin, setting.counter, setting.writer, setting.removed_up_to);
      }
    };
    for (const auto& robot : robots_) {
      if (robot->is_running()) add(robot->id().name, robot->Map());
    }
    for (const auto& client : clients_) add("client", ContentOf(client->follower));
    return text;
  }
  bool RunUntilEqual(int seconds) {
    for (int second = 0; second < seconds; ++second) {
      Run(milliseconds(1000));
      if (AllAreEqual()) return true;
    }
    return false;
  }

 private:
  // Of a robot, or of all clients; null where nobody signs. Robots and clients answer and decide.
  std::shared_ptr<const KeyRing> KeysOf(size_t n) const {
    if (!has_keys_) return nullptr;
    std::vector<TrustedKey> trusted;
    for (size_t k = 0; k <= robots_.size(); ++k) {
      trusted.push_back({fmt::format("{}", k), PublicKeyOf(TestSecret(int(k))), {}, true, true});
      if (k < robots_.size()) trusted.back().maps = {robots_[k]->id().name};
    }
    return *KeyRing::Make(TestSecret(int(n)), trusted);
  }

  void SpeakAsStranger() {
    if (recorded_.empty() || random_() % 4 != 0) return;
    std::vector<uint8_t> message = recorded_[random_() % recorded_.size()];
    switch (random_() % 3) {
      case 0:
        message[random_() % message.size()] ^= static_cast<uint8_t>(1u << random_() % 8);
        break;
      case 1:
        message.resize(message.size() - kSignatureBytes);  // as if nobody signed
        break;
      default:
        break;
    }
    Send(message);
  }

  // To all, the sender too: multicast comes back.
  void Broadcast(const std::vector<uint8_t>& message) {
    constexpr size_t kMaxRecorded = 5000;
    if (has_keys_ && recorded_.size() < kMaxRecorded) {
      recorded_.push_back(message);
    } else if (has_keys_) {
      recorded_[random_() % kMaxRecorded] = message;
    }
    Send(message);
  }
  void Send(const std::vector<uint8_t>& message) {
    const auto bytes = std::make_shared<const std::vector<uint8_t>>(message);
    bytes_sent_ += std::ssize(message);
    const auto digest = Decode<layer_digest_t>(message);
    proxy_digests_ += digest.ok() && !IsOwners(*digest) ? 1 : 0;
    for (const auto& robot : robots_) {
      network_.Send([this, bytes, r = robot.get()] {
        if (r->is_running()) r->HandleMessage(*bytes, network_.now());
      });
    }
    for (const std::weak_ptr<Client> client : clients_) {
      network_.Send([this, bytes, client] {
        if (const auto there = client.lock()) there->follower.HandleBytes(*bytes, network_.now());
      });
    }
  }

  Network network_;
  Random random_;
  std::vector<std::unique_ptr<Robot>> robots_;
  std::vector<std::shared_ptr<Client>> clients_;
  bool has_keys_ = false;
  std::vector<std::vector<uint8_t>> recorded_;  // by the stranger
  int64_t bytes_sent_ = 0;
  int64_t proxy_digests_ = 0;
};

TEST(FleetTest, EveryRobotAndClientHasTheSumOfAll) {
  Fleet fleet({.loss = 0.2}, 4, 2, 1);
  fleet.StartAll();
  for (int n = 0; n < 50; ++n) {
    for (size_t robot = 0; robot < 4; ++robot) fleet.robot(robot).Commit();
    fleet.Run(milliseconds(100));
  }
  ASSERT_TRUE(fleet.RunUntilEqual(30));
  EXPECT_EQ(fleet.AnyContent().layers.size(), 4u);
}

TEST(FleetTest, WhoComesLateGetsTheLayersOfThoseThatAreGone) {
  Fleet fleet({.loss = 0.2}, 3, 0, 2);
  fleet.Start(0);
  fleet.Start(1);
  for (int n = 0; n < 20; ++n) {
    fleet.robot(0).Commit();
    fleet.Run(milliseconds(100));
  }
  ASSERT_TRUE(fleet.RunUntilEqual(20));
  const Content content = fleet.AnyContent();
  fleet.robot(0).Stop();
  fleet.Run(milliseconds(60'000));
  fleet.Start(2);
  fleet.RestartClient(0);
  ASSERT_TRUE(fleet.RunUntilEqual(20));
  EXPECT_EQ(fleet.AnyContent(), content);
  // They also outlive the one that was their proxy.
  fleet.robot(1).Stop();
  fleet.Run(milliseconds(10'000));
  fleet.RestartClient(0);
  ASSERT_TRUE(fleet.RunUntilEqual(20));
  EXPECT_EQ(fleet.AnyContent(), content);
}

TEST(FleetTest, OneIsProxyForASilentOwnerAndNobodyForOneThatSpeaks) {
  Fleet fleet({.max_delay = milliseconds(30)}, 6, 2, 3);
  fleet.StartAll();
  for (int n = 0; n < 20; ++n) {
    fleet.robot(0).Commit();
    fleet.Run(milliseconds(100));
  }
  ASSERT_TRUE(fleet.RunUntilEqual(20));
  fleet.Run(milliseconds(10'000));
  EXPECT_EQ(fleet.proxy_digests(), 0);
  fleet.robot(0).Stop();
  fleet.Run(milliseconds(10'000));
  const int64_t before = fleet.proxy_digests();
  fleet.Run(milliseconds(20'000));
  EXPECT_LE(std::abs(fleet.proxy_digests() - before - 20), 2);
}

class TakingOver : public testing::TestWithParam<int> {};

TEST_P(TakingOver, IsForWhoHasMoreThanTheOneThatIsProxy) {
  Fleet fleet({}, 3, 1, GetParam());
  fleet.StartAll();
  fleet.robot(0).Commit();
  ASSERT_TRUE(fleet.RunUntilEqual(20));
  fleet.robot(1).Save();
  fleet.robot(1).Stop();
  fleet.robot(0).Commit();  // which robot 1 does not hear of
  ASSERT_TRUE(fleet.RunUntilEqual(20));
  const Content content = fleet.AnyContent();
  fleet.robot(0).Stop();
  fleet.robot(2).Save();
  fleet.robot(2).Stop();
  fleet.Start(1);
  fleet.RestartClient(0);
  ASSERT_TRUE(fleet.RunUntilEqual(20));
  EXPECT_NE(fleet.AnyContent(), content);
  EXPECT_EQ(fleet.AnyContent().layers.size(), 1u);
  fleet.Start(2);
  fleet.Run(milliseconds(5000));
  ASSERT_TRUE(fleet.RunUntilEqual(20));
  EXPECT_EQ(fleet.AnyContent().sum, content.sum);
  // And one of the two falls silent.
  const int64_t before = fleet.proxy_digests();
  fleet.Run(milliseconds(20'000));
  EXPECT_LE(std::abs(fleet.proxy_digests() - before - 20), 2);
}

INSTANTIATE_TEST_SUITE_P(Seeds, TakingOver, testing::Range(1, 9));

TEST(FleetTest, AProxyIsNotBelievedWhileTheOwnerSpeaks) {
  LayerFollower follower({"robot", 1}, 1);
  layer_digest_t digest{};
  digest.speaker = 1;
  digest.layer = ToMessage(LayerRef{{"robot", 1}, {1, 1}, {}});
  digest.protocol_version = kProtocolVersion;
  digest.root_level = 1;
  digest.utime = 1;
  const Clock::time_point begin{std::chrono::hours(1)};
  follower.HandleDigest(digest, begin);
  EXPECT_TRUE(follower.matches_digest());
  layer_digest_t proxy = digest;
  proxy.speaker = 5;
  proxy.num_tiles = 1;
  proxy.hash = 77;
  follower.HandleDigest(proxy, begin + milliseconds(2000));
  follower.Tick(begin + milliseconds(2000));
  EXPECT_TRUE(follower.matches_digest());
  proxy.utime = 2;
  follower.HandleDigest(proxy, begin + milliseconds(3500));
  EXPECT_FALSE(follower.matches_digest());
}

// Its last changes take many messages, of which each one lost others: copies of one revision, none
// of which is whole. Silence is noticed after 3 s.
TEST(FleetTest, WhatARobotSaidLastIsPutTogetherSoon) {
  constexpr int kFleets = 20;
  int seconds = 0;
  for (uint64_t seed = 1; seed <= kFleets; ++seed) {
    Fleet fleet({.loss = 0.2}, 5, 0, seed);
    fleet.StartAll();
    for (int n = 0; n < 10; ++n) {
      fleet.robot(0).Commit(40);
      fleet.Run(milliseconds(100));
    }
    fleet.Run(milliseconds(100));
    fleet.robot(0).Stop();
    for (int second = 0; second < 60 && !fleet.RunUntilEqual(1); ++second) ++seconds;
    EXPECT_TRUE(fleet.AllAreEqual()) << "seed " << seed << "\n" << fleet.Contents();
  }
  EXPECT_LT(seconds, 12 * kFleets);
}

// Nobody can ask for it afterwards.
TEST(FleetTest, ARobotThatLeavesWhileItMapsLeavesNothingBehind) {
  constexpr milliseconds kPatience(5000);
  // Where all asks of a follower get lost, or patience ends, some robots in a hundred leave before.
  int late = 0;
  int missed = 0;
  for (uint64_t seed = 1; seed <= 20; ++seed) {
    Fleet fleet({.loss = 0.25}, 2, 1, seed);
    fleet.StartAll();
    for (int n = 0; n < 10; ++n) {
      fleet.robot(0).Commit();
      fleet.Run(milliseconds(100));
    }
    fleet.robot(0).Commit(10);
    const uint64_t last = fleet.robot(0).Map().layers.at(fleet.robot(0).id()).second;
    const bool is_late = fleet.Leave(0, kPatience) >= kPatience;
    late += is_late ? 1 : 0;
    ASSERT_TRUE(fleet.RunUntilEqual(20)) << "seed " << seed << "\n" << fleet.Contents();
    if (is_late) continue;
    missed += fleet.AnyContent().layers.at(fleet.robot(0).id()).second == last ? 0 : 1;
  }
  EXPECT_LE(late, 6);
  EXPECT_LE(missed, 1);
}

TEST(FleetTest, AnOwnerThatNobodyFollowsLeavesAtOnce) {
  Fleet fleet({}, 1, 0, 1);
  fleet.StartAll();
  fleet.robot(0).Commit();
  EXPECT_LE(fleet.Leave(0, milliseconds(3000)), milliseconds(500));
}

// The next digest of each robot is up to a second away, or lost.
TEST(FleetTest, WhoComesHearsOfAllRobotsSoon) {
  constexpr size_t kRobots = 10;
  for (uint64_t seed = 1; seed <= 50; ++seed) {
    Fleet fleet({.loss = 0.15}, kRobots, 0, seed);
    fleet.StartAll();
    for (size_t n = 0; n < kRobots; ++n) fleet.robot(n).Commit();
    fleet.Run(milliseconds(5000));
    fleet.robot(0).Stop();  // others speak for it
    fleet.Run(milliseconds(5000));
    fleet.RestartClient(0);
    fleet.Run(milliseconds(2000));
    EXPECT_EQ(fleet.client(0).Layers().layers.size(), kRobots) << "seed " << seed;
  }
}

TEST(FleetTest, ARobotThatComesBackSpeaksForItself) {
  Fleet fleet({.loss = 0.1}, 3, 1, 4);
  fleet.StartAll();
  for (int n = 0; n < 20; ++n) {
    fleet.robot(0).Commit();
    fleet.Run(milliseconds(100));
  }
  ASSERT_TRUE(fleet.RunUntilEqual(20));
  fleet.robot(0).Save();
  fleet.robot(0).Stop();
  fleet.Run(milliseconds(15'000));
  fleet.Start(0);
  fleet.robot(0).Commit();
  ASSERT_TRUE(fleet.RunUntilEqual(20));
  const LayerId id = fleet.robot(0).id();
  EXPECT_EQ(fleet.AnyContent().layers.at(id).first.number, 2u);
}

TEST(FleetTest, RemovingALayerLeavesTheMapThatNeverHadItThoughItsRobotWasAway) {
  Fleet fleet({.loss = 0.2}, 4, 1, 5);
  fleet.StartAll();
  for (int n = 0; n < 20; ++n) {
    for (size_t robot = 0; robot < 4; ++robot) fleet.robot(robot).Commit();
    fleet.Run(milliseconds(100));
  }
  ASSERT_TRUE(fleet.RunUntilEqual(30));
  LayerSet without = fleet.robot(0).Layers();
  const LayerId id = fleet.robot(3).id();
  std::erase_if(without.layers, [&](const LayerSnapshot& layer) { return layer.id == id; });
  const uint64_t expected = HashOf(ViewOf(without)->tiles);

  fleet.robot(3).Save();
  fleet.robot(3).Stop();
  fleet.Run(milliseconds(5000));
  const LayerSet set = fleet.client(0).Layers();
  const LayerSnapshot* layer = set.Find(id);
  ASSERT_NE(layer, nullptr);
  fleet.client(0).Set(id, set.settings.Removal(id, layer->session, 1));
  ASSERT_TRUE(fleet.RunUntilEqual(20));
  EXPECT_EQ(fleet.AnyContent().sum, expected);
  // It comes back with all that it had, twice started since.
  fleet.Start(3);
  fleet.robot(3).Stop();
  fleet.Start(3);
  fleet.Run(milliseconds(10'000));
  ASSERT_TRUE(fleet.RunUntilEqual(20));
  EXPECT_EQ(fleet.AnyContent().sum, expected);
  // And maps anew.
  fleet.robot(3).Commit();
  ASSERT_TRUE(fleet.RunUntilEqual(20));
  EXPECT_EQ(fleet.AnyContent().layers.at(id).first.number, LayerSettings::kSessionsPerGeneration);
}

// The first that was heard owes nothing to anybody: its copies go on from the last whole one.
TEST(FleetTest, ASessionThatWasNeverWholeIsGivenUp) {
  Fleet fleet({}, 2, 1, 6);
  fleet.StartAll();
  fleet.robot(0).Commit();
  ASSERT_TRUE(fleet.RunUntilEqual(20));
  const Content content = fleet.AnyContent();
  fleet.robot(0).Save();
  fleet.robot(0).Stop();
  fleet.Start(0);
  fleet.Run(milliseconds(40));  // a digest of another session, and nothing of it
  fleet.robot(0).Stop();
  fleet.Run(milliseconds(15'000));
  fleet.RestartClient(0);
  ASSERT_TRUE(fleet.RunUntilEqual(30));
  EXPECT_EQ(fleet.AnyContent().sum, content.sum);
}

class RandomFleet : public testing::TestWithParam<int> {
 protected:
  static void Run(Random random, int schedules, bool has_keys);
};

TEST_P(RandomFleet, EndsWithEqualBytes) { Run(Random(GetParam()), NumSchedules(2), false); }

// Fewer, since to check signatures takes most of the time.
class SignedFleet : public RandomFleet {};

TEST_P(SignedFleet, EndsWithEqualBytesWhateverAStrangerSends) {
  Run(Random(GetParam()), NumSchedules(1), true);
}

void RandomFleet::Run(Random random, int schedules, bool has_keys) {
  for (int schedule = 0; schedule < schedules; ++schedule) {
    const uint64_t seed = random();
    SCOPED_TRACE(seed);
    const auto any = [&](auto... values) { return AnyOf(random, values...); };
    const Weather weather{any(0.0, 0.05, 0.3), any(0.0, 0.3),
                          any(milliseconds(0), milliseconds(30), milliseconds(400))};
    Fleet fleet(weather, any(2, 3, 5), any(1, 2), seed);
    if (has_keys) fleet.UseKeys();
    fleet.StartAll();
    for (int event = 0; event < 50; ++event) {
      const size_t n = random() % fleet.num_robots();
      Robot& robot = fleet.robot(n);
      switch (random() % 13) {
        case 0:
          fleet.network().SetCut(true);
          break;
        case 1:
          fleet.RestartClient(random() % fleet.num_clients());
          break;
        case 2:
          robot.Stop();
          break;
        case 3:
          if (robot.is_running()) robot.Save();
          break;
        case 4:
          robot.Stop();
          robot.RestoreOlderFile();
          fleet.Start(n);
          break;
        case 5:
          if (robot.is_running()) robot.SetSomething();
          break;
        case 6:
          fleet.Run(milliseconds(5000));
          break;
        case 7:
          if (robot.is_running()) robot.Refold();
          break;
        default:
          fleet.network().SetCut(false);
          if (random() % 2 == 0) fleet.Start(n);
          for (int commit = 0; commit < 5; ++commit) {
            if (robot.is_running()) robot.Commit();
            fleet.Run(milliseconds(60));
          }
      }
    }
    // From now on packets get through, most of them; one robot at least is there.
    fleet.network().SetCut(false);
    fleet.Start(0);
    if (!fleet.RunUntilEqual(90)) {
      FAIL() << *fleet.DifferenceFrom(fleet.AnyContent()) << " has another map than others:\n"
             << fleet.Contents();
    }
  }
}

INSTANTIATE_TEST_SUITE_P(Seeds, RandomFleet, testing::Range(1, 9));
INSTANTIATE_TEST_SUITE_P(Seeds, SignedFleet, testing::Range(1, 4));

}  // namespace splinemap::fleet_test
