// Sequences of messages of the protocol, with fields that are changed, doubled, put in another
// order and mixed among layers, into a daemon that saves after each one, and whose file is read
// then.
#include <spdlog/spdlog.h>

#include <chrono>
#include <cstdio>
#include <filesystem>
#include <map>
#include <random>

#include "CLI/CLI.hpp"
#include "absl/strings/escaping.h"
#include "lcmtypes/splinemap/command_request_t.hpp"
#include "lcmtypes/splinemap/layer_digest_t.hpp"
#include "lcmtypes/splinemap/layer_status_t.hpp"
#include "lcmtypes/splinemap/layer_updates_t.hpp"
#include "lib/base/status.h"
#include "lib/config/config.h"
#include "lib/replication/replication_message.h"
#include "lib/wire/decode.h"
#include "splinemap/file.h"
#include "tests/support/honest_owner.h"
#include "tests/support/lcm_fields.h"
#include "tests/support/map_writer.h"
#include "tests/support/memory_daemon.h"
#include "tests/support/random_map.h"
#include "tests/support/valid_messages.h"

namespace splinemap {
namespace {

using Bytes = std::vector<uint8_t>;
using Random = std::mt19937_64;

const MapOptions kOptions = MapOptionsOf(config::Method());  // of the daemon
// A daemon goes on from its file after half of a block, and from the first file after one.
constexpr int64_t kBlock = 400;

size_t Below(size_t end, Random& random) {
  return std::uniform_int_distribution<size_t>(0, end - 1)(random);
}
bool Chance(double probability, Random& random) {
  return std::bernoulli_distribution(probability)(random);
}

// The robot's own layer, and one whose owner is away.
LayerSet FirstMap() {
  Random random(1);
  MapWriter map(kOptions);
  for (const char* name : {"robot", "away"}) {
    Layer& layer = map.AddLayer({name, random()}, {1, random()});
    layer.BeginCommit();
    layer.EditTile({0, 0}) = RandomTile(random, kOptions.limits);
    layer.EditTile({-1, 0}) = RandomTile(random, kOptions.limits);
  }
  map.SetOwnLayer(map.layers()[0].id());
  return map.Layers();
}

struct Template {
  std::string channel;
  LcmValue message;
};

// Valid messages, and what their fields hold.
class Pool {
 public:
  // `own` is the present session of the daemon's own layer.
  Pool(const LayerSet& map, const LayerRef& own, int64_t daemon_nonce) {
    const LayerSnapshot& away = map.layers[1];
    for (const LayerSnapshot& layer :
         {LayerSnapshot{own.id, own.session, map.layers[0].revision, map.layers[0].tiles}, away,
          HonestOwner("owner", kOptions, 5).truth()}) {
      Add(MessagesOf(layer, kOptions), templates_);
      Add({FalseScan(layer), FalseUpdates(layer, 100), FalseUpdates(layer, 3000),
           SettingsMessage(layer.id, 1), SettingsMessage({"nobody", layer.id.origin}, 1)},
          templates_);
    }
    Add(Queries(daemon_nonce), templates_);
    Add({Command("clear", own.session.number, daemon_nonce + 1)}, templates_);
    Add(LayerCommands(away, daemon_nonce), layer_commands_);
    for (std::vector<Template>* some : {&templates_, &layer_commands_}) {
      for (Template& known : *some) {
        for (const LcmField& field : FieldsOf(known.message)) {
          values_[{field.value->type, field.value->name}].push_back(field.value->bytes);
        }
      }
    }
  }

  // Commands about layers seldom: for each the daemon waits for its mapping thread, up to 50 ms.
  const Template& Draw(Random& random) const {
    const std::vector<Template>& some = Chance(0.01, random) ? layer_commands_ : templates_;
    return some[Below(some.size(), random)];
  }
  // What some field of that type and name holds.
  const std::string& DrawValue(const LcmValue& field, Random& random) const {
    const std::vector<std::string>& values = values_.at({field.type, field.name});
    return values[Below(values.size(), random)];
  }

 private:
  void Add(const std::vector<ValidMessage>& messages, std::vector<Template>& templates) const {
    for (const ValidMessage& message : messages) {
      templates.push_back(
          {"SPLINEMAP" + message.channel, types_.Parse(message.type, message.bytes)});
    }
  }

  LcmTypes types_{SPLINEMAP_LCM_TYPES};
  std::vector<Template> templates_;
  std::vector<Template> layer_commands_;
  std::map<std::pair<std::string, std::string>, std::vector<std::string>> values_;
};

void Change(LcmValue& message, const Pool& pool, Random& random) {
  const std::vector<LcmField> fields = FieldsOf(message);
  const LcmField& field = fields[Below(fields.size(), random)];
  std::string& bytes = field.value->bytes;
  const size_t kind = Below(10, random);
  if (field.is_count && kind < 5 && bytes.back() != 0) {
    constexpr size_t kSizes[] = {0, 1, 2, 3, 100};
    return Resize(field, kSizes[Below(std::size(kSizes), random)], Chance(0.5, random));
  }
  if (kind < 5) {
    bytes = pool.DrawValue(*field.value, random);
  } else if (kind < 8 || bytes.empty()) {
    const std::vector<std::string> extremes = ExtremesOf(*field.value);
    bytes = extremes[Below(extremes.size(), random)];
  } else if (kind == 8) {
    bytes.back() = static_cast<char>(bytes.back() + (Chance(0.5, random) ? 1 : -1));
  } else {
    bytes[Below(bytes.size(), random)] = static_cast<char>(random());
  }
}

// Whoever knows the nonce of the daemon may clear its layer.
bool MayClear(absl::Span<const uint8_t> message, int64_t daemon_nonce) {
  const auto request = Decode<command_request_t>(message);
  return request.ok() && request->header.daemon_nonce == daemon_nonce;
}

// Some messages, mostly changed in one field, some doubled, in any order.
std::vector<std::pair<std::string, Bytes>> MakeSequence(const Pool& pool, int64_t daemon_nonce,
                                                        Random& random) {
  std::vector<std::pair<std::string, Bytes>> sequence;
  for (size_t left = 1 + Below(6, random); left > 0; --left) {
    const Template& known = pool.Draw(random);
    LcmValue message = known.message;
    while (Chance(0.55, random)) Change(message, pool, random);
    const Bytes bytes = Encode(message);
    if (MayClear(bytes, daemon_nonce)) continue;
    for (int copies = Chance(0.1, random) ? 2 : 1; copies > 0; --copies) {
      sequence.emplace_back(known.channel, bytes);
    }
  }
  std::shuffle(sequence.begin(), sequence.end(), random);
  return sequence;
}

bool HaveSameTiles(const TileTree& a, const TileTree& b) {
  bool same = a.size() == b.size();
  a.ForEach([&](TileKey key, const TileTree::Entry& entry) {
    const StoredTile* other = b.Find(key);
    same = same && other != nullptr && HaveEqualContent(*other, *entry.tile);
  });
  return same;
}

class Fuzz {
 public:
  Fuzz(std::string folder, uint64_t seed, bool is_verbose)
      : folder_(std::move(folder)), seed_(seed), is_verbose_(is_verbose), map_(FirstMap()) {
    config_.set_name("robot");
    config_.set_map(folder_ + "/robot.splinemap");
    config_.set_pose("POSE");
    config_.add_scan()->set_channel("LASER");
    config_.mutable_service()->set_save_interval_s(3600);
    config_.mutable_service()->add_follow("*");
  }

  // From `first`, the first of a block, on. What is wrong, with what tells how to see it again.
  absl::Status Run(int64_t first, int64_t sequences) {
    const auto begin = Clock::now();
    auto next_line = begin;
    for (int64_t n = first; n < first + sequences; ++n) {
      if (n % kBlock == 0)
        SPLINEMAP_RETURN_IF_ERROR(Named(n, BeginAnew()));
      else if (n % (kBlock / 2) == 0)
        SPLINEMAP_RETURN_IF_ERROR(Named(n, Restart()));
      SPLINEMAP_RETURN_IF_ERROR(Named(n, RunOne(n)));
      if (Clock::now() < next_line && n + 1 < first + sequences) continue;
      next_line = Clock::now() + std::chrono::seconds(10);
      const std::chrono::duration<double> time = Clock::now() - begin;
      const auto done = static_cast<double>(n + 1 - first);
      fmt::print("{} sequences of {} messages, {:.0f} a second\n", done, messages_,
                 done / time.count());
      std::fflush(stdout);
    }
    return daemon_->Stop();
  }

 private:
  absl::Status Named(int64_t n, const absl::Status& status) const {
    if (status.ok()) return status;
    return absl::Status(
        status.code(),
        fmt::format("sequence {}: {}; again with --seed {} --first {} --sequences {} "
                    "--verbose",
                    n, std::string(status.message()), seed_, n - n % kBlock, n % kBlock + 1));
  }

  absl::Status BeginAnew() {
    if (daemon_) SPLINEMAP_RETURN_IF_ERROR(daemon_->Stop());
    daemon_.reset();
    std::filesystem::remove(config_.map());
    SPLINEMAP_RETURN_IF_ERROR(WriteFirstFile());
    return StartDaemon();
  }

  absl::Status WriteFirstFile() {
    SPLINEMAP_ASSIGN_OR_RETURN(MapFile file, MapFile::Open(config_.map()));
    SPLINEMAP_RETURN_IF_ERROR(file.Save(map_).status());
    return file.Close();
  }

  absl::Status Restart() {
    SPLINEMAP_RETURN_IF_ERROR(daemon_->Stop());
    return StartDaemon();
  }

  absl::Status StartDaemon() {
    daemon_.reset();
    SPLINEMAP_ASSIGN_OR_RETURN(daemon_, MemoryDaemon::Start(config_));
    SPLINEMAP_ASSIGN_OR_RETURN(const LayerRef own, OwnSession());
    pool_.emplace(map_, own, daemon_->nonce());
    return absl::OkStatus();
  }

  absl::StatusOr<LayerRef> OwnSession() {
    const auto layers = daemon_->Layers();
    if (!layers) return absl::DeadlineExceededError("the daemon does not tell its layers");
    const layer_status_t& own = layers->layers.at(0);
    return LayerRef{
        {own.settings.name, static_cast<uint64_t>(own.settings.origin)},
        {static_cast<uint64_t>(own.session_number), static_cast<uint64_t>(own.session_nonce)},
        {}};
  }

  absl::Status RunOne(int64_t n) {
    std::seed_seq seed{seed_, static_cast<uint64_t>(n)};
    Random random(seed);
    for (const auto& [channel, message] : MakeSequence(*pool_, daemon_->nonce(), random)) {
      ++messages_;
      if (is_verbose_) {
        fmt::print("{} {} {}\n", n, channel,
                   absl::BytesToHexString(
                       {reinterpret_cast<const char*>(message.data()), message.size()}));
      }
      daemon_->Publish(channel, message);
    }
    SPLINEMAP_RETURN_IF_ERROR(AwaitEnd());
    SPLINEMAP_RETURN_IF_ERROR(daemon_->Save());
    return CheckFile();
  }

  // Messages are taken in their order: what a robot maps at their end is seen then.
  absl::Status AwaitEnd() {
    ++end_.revision;
    Tile tile;
    tile.control_points.fill(static_cast<ControlPoint>(1 + end_.revision % 1000));
    TileTreeEditor tiles;
    tiles.Put({0, 0}, std::make_shared<const StoredTile>(tile), end_.revision);
    end_.tiles = tiles.Freeze();
    for (const ValidMessage& message : MessagesOf(end_, kOptions)) {
      if (message.type == "layer_digest_t" && SpeakerOf(message.bytes) == end_.session.nonce) {
        daemon_->Publish("SPLINEMAP_DIGESTS", message.bytes);
      }
      if (message.type == "layer_updates_t") updates_ = message.bytes;
    }
    daemon_->Publish("SPLINEMAP_UPDATES", updates_);
    for (const auto deadline = Clock::now() + std::chrono::seconds(10); Clock::now() < deadline;) {
      const auto layers = daemon_->Layers();
      if (!layers) break;
      for (const layer_status_t& layer : layers->layers) {
        if (layer.settings.name == end_.id.name &&
            layer.revision == static_cast<int64_t>(end_.revision)) {
          return absl::OkStatus();
        }
      }
    }
    return absl::DeadlineExceededError("the daemon does not take messages any more");
  }

  absl::Status CheckFile() {
    SPLINEMAP_ASSIGN_OR_RETURN(const LoadedMap loaded, ReadMapFile(config_.map()));
    if (!loaded.corruption.empty()) return absl::DataLossError(loaded.corruption[0]);
    const LayerSet& map = loaded.set;
    if (!map.own_layer) return absl::DataLossError("the file does not say which layer is its own");
    const LayerSnapshot* saved = map.Find(*map.own_layer);
    if (saved == nullptr) return absl::DataLossError("the file lacks the own layer");
    if (HaveSameTiles(saved->tiles, map_.layers[0].tiles)) return absl::OkStatus();
    // By a setting that all may make.
    if (map.settings.Of(saved->id).removed_up_to > 0 && saved->tiles.size() == 0) {
      return BeginAnew();
    }
    return absl::DataLossError("the own layer has changed");
  }

  const std::string folder_;
  const uint64_t seed_;
  const bool is_verbose_;
  const LayerSet map_;
  config::Config config_;
  std::unique_ptr<MemoryDaemon> daemon_;
  std::optional<Pool> pool_;
  LayerSnapshot end_{{"end", 1}, {1, 1}, 0, {}};
  Bytes updates_;
  int64_t messages_ = 0;
};

int Main(int argc, char** argv) {
  CLI::App app{"Sequences of hostile messages into a daemon that saves, and whose file is read."};
  uint64_t seed = 1;
  int64_t first = 0;
  int64_t sequences = 1000;
  bool is_verbose = false;
  app.add_option("--seed", seed, "of all that is drawn");
  app.add_option("--first", first, fmt::format("sequence to begin with, a multiple of {}", kBlock));
  app.add_option("--sequences", sequences, "how many");
  app.add_flag("--verbose", is_verbose, "print each message");
  CLI11_PARSE(app, argc, argv);
  if (first % kBlock != 0) {
    fmt::print(stderr, "--first {} is no multiple of {}\n", first, kBlock);
    return 2;
  }
  spdlog::set_level(spdlog::level::off);
  // In memory where that can be, since each sequence is saved and read.
  std::string folder =
      (std::filesystem::exists("/dev/shm") ? "/dev/shm" : std::filesystem::temp_directory_path()) /
      std::filesystem::path("daemon_fuzz_XXXXXX");
  if (mkdtemp(folder.data()) == nullptr) {
    fmt::print(stderr, "cannot make a folder {}\n", folder);
    return 1;
  }
  const absl::Status status = Fuzz(folder, seed, is_verbose).Run(first, sequences);
  if (status.ok()) {
    std::filesystem::remove_all(folder);
    return 0;
  }
  fmt::print(stderr, "{}\nthe map file is in {}\n", std::string(status.message()), folder);
  return 1;
}

}  // namespace
}  // namespace splinemap

int main(int argc, char** argv) { return splinemap::Main(argc, argv); }
