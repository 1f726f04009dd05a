// Every field of what comes over a bus, to its extremes, against whole daemons, each beside an
// honest owner of a layer.
#include <gtest/gtest.h>
#include <spdlog/spdlog.h>

#include <atomic>
#include <deque>
#include <filesystem>
#include <functional>
#include <numbers>
#include <set>
#include <thread>

#include "absl/strings/str_replace.h"
#include "lcmtypes/splinemap/command_reply_t.hpp"
#include "lcmtypes/splinemap/command_request_t.hpp"
#include "lcmtypes/splinemap/layer_command_request_t.hpp"
#include "lcmtypes/splinemap/layer_pull_t.hpp"
#include "lcmtypes/splinemap/layer_status_t.hpp"
#include "lcmtypes/splinemap/layer_updates_t.hpp"
#include "lcmtypes/splinemap/layers_t.hpp"
#include "lcmtypes/splinemap/settings_t.hpp"
#include "lcmtypes/splinemap/status_t.hpp"
#include "lib/config/config.h"
#include "lib/replication/hash_tree.h"
#include "lib/replication/replication_message.h"
#include "lib/tiles/tile_codec.h"
#include "lib/wire/encode.h"
#include "splinemap/file.h"
#include "tests/integration/field_walk/variants.h"
#include "tests/support/honest_owner.h"
#include "tests/support/memory_daemon.h"
#include "tests/support/temporary_directory.h"
#include "tests/support/valid_messages.h"

namespace splinemap::field_walk_daemon_test {

using std::chrono::milliseconds;
using std::chrono::seconds;

// As daemons have them by themselves: else they refuse the owner's layer.
const MapOptions kOptions = MapOptionsOf(config::Method());

std::string TextOf(const absl::Status& status) { return std::string(status.message()); }

// A daemon that has mapped something, and the owner of another layer, on one bus.
class Site {
 public:
  // In the map file `path`, which is removed.
  explicit Site(const std::string& path) {
    std::filesystem::remove(path);
    config_.set_name("robot");
    config_.set_map(path);
    config_.set_pose("POSE");
    config_.add_scan()->set_channel("LASER");
    config_.mutable_service()->set_save_interval_s(3600);
    config_.mutable_service()->add_follow("*");
    const auto hear = [this](absl::Span<const uint8_t> message) {
      MutexLock lock(mutex_);
      heard_.emplace_back(message.begin(), message.end());
    };
    auto daemon = MemoryDaemon::Start(
        config_, {kDigestChannel, ChannelOf(layer_pull_t(), ""), ChannelOf(settings_t(), "")},
        hear);
    EXPECT_TRUE(daemon.ok()) << daemon.status();
    daemon_ = *std::move(daemon);
    EXPECT_TRUE(Drive(5));
    EXPECT_TRUE(daemon_->Save().ok());
    mapped_ = ReadMapFile(path)->set.layers.at(0).tiles;
  }

  HonestOwner& owner() { return owner_; }
  MemoryDaemon& daemon() { return *daemon_; }
  LayerSnapshot own() {
    const layer_status_t own = OwnStatus();
    return {{own.settings.name, static_cast<uint64_t>(own.settings.origin)},
            {static_cast<uint64_t>(own.session_number), static_cast<uint64_t>(own.session_nonce)},
            static_cast<uint64_t>(own.revision),
            mapped_};
  }

  void Publish(const std::string& channel, absl::Span<const uint8_t> message) {
    daemon_->Publish("SPLINEMAP" + channel, message);
  }

  // The owner hears and speaks.
  void Talk() {
    std::deque<std::vector<uint8_t>> heard;
    {
      MutexLock lock(mutex_);
      heard.swap(heard_);
    }
    for (const auto& message : heard) owner_.Hear(message, Clock::now());
    for (const ReplicationMessage& said : owner_.Speak(Clock::now())) {
      Publish(ChannelOf(said, ""), EncodeReplication(said));
    }
    std::this_thread::sleep_for(milliseconds(10));
  }

  // False where the condition does not hold within 15 s.
  bool Await(const std::function<bool()>& holds) {
    for (const auto end = Clock::now() + seconds(15); Clock::now() < end;) {
      if (holds()) return true;
      Talk();
    }
    return false;
  }

  // A robot that turns in a round room of 3 m; whether it was mapped.
  bool Drive(int scans) {
    const int64_t before = OwnStatus().revision;
    for (int n = 0; n < scans; ++n) {
      utime_ += milliseconds(100);
      daemon_->Publish("POSE", Encode(PoseMessage({utime_, {{0, 0}, 0.1 * n}})));
      daemon_->Publish("LASER", Encode(PlanarLidarMessage(utime_, std::vector<float>(90, 3), 0,
                                                          2 * std::numbers::pi / 90)));
    }
    return Await([&] { return OwnStatus().revision >= before + scans; });
  }

  // Empty where nothing is.
  std::string WhatIsWrong() {
    std::string not_live;
    if (!Await([&] { return (not_live = WhatIsNotLive()).empty(); })) return not_live;
    if (const absl::Status saved = daemon_->Save(); !saved.ok()) return TextOf(saved);
    const auto file = ReadMapFile(config_.map());
    if (const std::string wrong = WhatIsWrongWith(file); !wrong.empty()) return wrong;
    const LayerSnapshot* own_layer = OwnLayer(file->set);
    if (own_layer == nullptr) return "the file lacks the own layer";
    if (HashOf(own_layer->tiles) != HashOf(mapped_)) return "the own layer has changed";
    if (!Drive(3)) return "the robot does not map any more";
    for (const char* command : {"mute", "unmute"}) {
      const absl::Status set = daemon_->Set(command, own().id);
      if (!set.ok()) return "no setting can be changed: " + TextOf(set);
      if ((OwnStatus().settings.muted != 0) != (std::string(command) == "mute"))
        return "nobody obeys";
    }
    if (const absl::Status stopped = daemon_->Stop(); !stopped.ok()) return TextOf(stopped);
    return WhatIsWrongWith(ReadMapFile(config_.map()));
  }

 private:
  static std::string WhatIsWrongWith(const absl::StatusOr<LoadedMap>& loaded) {
    if (!loaded.ok()) return TextOf(loaded.status());
    return loaded->corruption.empty() ? "" : loaded->corruption[0];
  }

  // Null where the file does not have it.
  static const LayerSnapshot* OwnLayer(const LayerSet& set) {
    return set.own_layer ? set.Find(*set.own_layer) : nullptr;
  }

  static uint64_t HashOf(const TileTree& tiles) {
    HashTree hashes;
    tiles.ForEach([&](TileKey key, const TileTree::Entry& entry) {
      hashes.Set(key, TileChecksum(key, *entry.tile->Get()));
    });
    return hashes.hash();
  }

  layer_status_t OwnStatus() { return daemon_->Layers().value().layers.at(0); }

  // The layer of the owner is to be live with what it has mapped, and what others have never.
  std::string WhatIsNotLive() {
    bool is_live = false;
    const layers_t layers = daemon_->Layers().value();
    for (const layer_status_t& layer : layers.layers) {
      if (layer.state != "live") continue;
      const bool is_owners =
          LayerId{layer.settings.name, static_cast<uint64_t>(layer.settings.origin)} ==
          owner_.ref().id;
      is_live |= is_owners && static_cast<uint64_t>(layer.hash) == HashOf(owner_.truth().tiles);
      if (!is_owners && layer.num_tiles > 0) return "a layer without an owner is live";
    }
    return is_live ? "" : "the layer of an owner that speaks is not live";
  }

  config::Config config_;
  HonestOwner owner_{"owner", kOptions, 1};
  Utime utime_{0};
  TileTree mapped_;
  Mutex mutex_;
  std::deque<std::vector<uint8_t>> heard_ ABSL_GUARDED_BY(mutex_);
  std::unique_ptr<MemoryDaemon> daemon_;
};

struct Walk {
  std::string name;
  std::function<ValidMessage(Site&)> make;  // as it is valid at the moment
};

// All messages that a daemon takes, of the owner's layer and of its own. What may remove its own
// layer, or clear it, is not among them.
std::vector<Walk> Walks() {
  std::vector<Walk> walks;
  const LayerSnapshot example = HonestOwner("owner", kOptions, 1).truth();
  for (size_t k = 0; k < MessagesOf(example, kOptions).size(); ++k) {
    const std::string type = MessagesOf(example, kOptions)[k].type;
    walks.push_back({type + " of another layer",
                     [k](Site& site) { return MessagesOf(site.owner().truth(), kOptions).at(k); }});
    walks.push_back({type + " of the own layer",
                     [k](Site& site) { return MessagesOf(site.own(), kOptions).at(k); }});
  }
  walks.push_back({"layer_updates_t that nobody made",
                   [](Site& site) { return FalseUpdates(site.owner().truth(), 100); }});
  walks.push_back({"layer_scans_t that nobody made",
                   [](Site& site) { return FalseScan(site.owner().truth()); }});
  walks.push_back({"settings_t of another layer",
                   [](Site& site) { return SettingsMessage(site.owner().ref().id, 1); }});
  walks.push_back({"trajectory_t of another robot", [](Site&) { return TrajectoryMessage(); }});
  walks.push_back({"settings_t of nobody", [](Site&) {
                     return SettingsMessage({"nobody", 1}, 1);
                   }});
  for (size_t k = 0; k < Queries(0).size(); ++k) {
    walks.push_back(
        {Queries(0)[k].type, [k](Site& site) { return Queries(site.daemon().nonce())[k]; }});
  }
  walks.push_back({"layer_command_request_t", [](Site& site) {
                     return LayerCommands(site.owner().truth(), site.daemon().nonce())[4];
                   }});
  walks.push_back({"command_request_t", [](Site& site) {
                     return Command("save", site.own().session.number, site.daemon().nonce());
                   }});
  walks.push_back({"command_request_t for another daemon", [](Site& site) {
                     return Command("clear", site.own().session.number, site.daemon().nonce() + 1);
                   }});
  return walks;
}

TEST(FieldWalkTest, NoMessageIsForgotten) {
  spdlog::set_level(spdlog::level::off);
  std::set<std::string> walked{"command_reply_t"};
  for (const ValidMessage& query : Queries(0)) {
    walked.insert(absl::StrReplaceAll(query.type, {{"_request_t", "_reply_t"}}));
  }
  const TemporaryDirectory directory;
  Site site(directory.File("map"));
  for (const Walk& walk : Walks()) walked.insert(walk.make(site).type);
  // What daemons tell people, and take from nobody.
  walked.insert({"layers_t", "status_t"});
  for (const std::string& message : Types().Messages()) {
    EXPECT_TRUE(walked.contains(message)) << message;
  }
}

class DaemonWalkTest : public testing::Test {
 protected:
  DaemonWalkTest() { spdlog::set_level(spdlog::level::off); }

  static std::string Try(const std::string& path, const Walk& walk,
                         absl::Span<const Variant> variants) {
    Site site(path);
    for (size_t k = 0; k < variants.size(); ++k) {
      const ValidMessage message = walk.make(site);
      site.Publish(message.channel, Apply(variants[k], Types().Parse(message.type, message.bytes)));
      if (k % 8 == 0) site.Talk();
    }
    return site.WhatIsWrong();
  }

  const TemporaryDirectory directory_;
};

TEST_F(DaemonWalkTest, NoFieldOfAMessageHarmsADaemon) {
  const std::vector<Walk> walks = Walks();
  ASSERT_EQ(Try(directory_.File("map"), walks[0], {}), "");
  Tally tally("daemon");
  std::atomic<size_t> next = 0;
  Mutex mutex;  // of tally
  // Daemons wait more than they work.
  std::vector<std::jthread> threads;
  for (int n = 0; n < 8; ++n) {
    threads.emplace_back([&] {
      for (size_t k; (k = next++) < walks.size();) {
        const std::string path = directory_.File(fmt::format("{}", k));
        const ValidMessage example = [&] {
          Site site(path);
          return walks[k].make(site);
        }();
        const auto variants = VariantsOf(Types().Parse(example.type, example.bytes));
        {
          MutexLock lock(mutex);
          tally.Add(variants);
        }
        const auto run = [&](absl::Span<const Variant> some) { return Try(path, walks[k], some); };
        for (const std::string& culprit : FindCulprits(variants, variants.size(), run)) {
          ADD_FAILURE() << walks[k].name << ": " << culprit;
        }
      }
    });
  }
}

}  // namespace splinemap::field_walk_daemon_test
