// Equal messages in equal order make equal bytes: in the daemon and without it, on a busy machine,
// whoever looks on. And where channels only overtake each other, the order does not matter either.
#include <gtest/gtest.h>
#include <spdlog/spdlog.h>

#include <algorithm>
#include <cmath>
#include <functional>
#include <map>
#include <random>
#include <string>
#include <thread>
#include <vector>

#include "fmt/ranges.h"
#include "lcmtypes/michigan/lidar_t.hpp"
#include "lib/pipeline/mapper.h"
#include "lib/tiles/tile_codec.h"
#include "lib/wire/encode.h"
#include "services/splinemapd/daemon.h"
#include "splinemap/file.h"
#include "tests/support/map_writer.h"
#include "tests/support/num_schedules.h"
#include "tests/support/raw_message.h"
#include "tests/support/temporary_directory.h"

namespace splinemap::replay_property_test {

using std::chrono::microseconds;
using std::chrono::milliseconds;
using Random = std::mt19937_64;
using Bytes = std::vector<uint8_t>;

double Uniform(Random& random, double min, double max) {
  return std::uniform_real_distribution<double>(min, max)(random);
}
bool Chance(Random& random, double probability) {
  return std::bernoulli_distribution(probability)(random);
}
// 0 .. n - 1.
size_t Index(Random& random, size_t n) {
  return std::uniform_int_distribution<size_t>(0, n - 1)(random);
}

struct Message {
  std::string channel;
  Bytes bytes;
};
using Log = std::vector<Message>;

config::Config ThreeScanners() {
  config::Config config;
  config.set_name("robot");
  config.set_pose("POSE");
  for (const char* flag : {"LASER", "LIDAR:michigan_2014,x_m=0.1",
                           "REAR:bot_core,yaw_deg=180,time_offset_ms=-40,scan_duration_ms=60,"
                           "range_max_m=4,no_return=free"}) {
    *config.add_scan() = *ParseScanFlag(flag);
  }
  return config;
}

// What a robot says that drives about: per channel, in order of time.
struct TimedBytes {
  int64_t ms = 0;
  Bytes bytes;
};
using Drive = std::map<std::string, std::vector<TimedBytes>>;

std::vector<float> SomeRanges(Random& random) {
  std::vector<float> ranges_m(3 + Index(random, 7));
  for (float& range_m : ranges_m) {
    range_m = Chance(random, 0.1) ? 0 : static_cast<float>(Uniform(random, 0.3, 4));
  }
  return ranges_m;
}

Bytes SomeLidar(Random& random, int64_t ms) {
  michigan::lidar_t lidar;
  lidar.utime = 1000 * ms;
  lidar.ranges = SomeRanges(random);
  lidar.num_ranges = static_cast<int32_t>(lidar.ranges.size());
  for (int k = 0; k < lidar.num_ranges; ++k) {
    lidar.thetas.push_back(static_cast<float>(0.4 * k));
    lidar.times.push_back(lidar.utime + int64_t{5000} * k);
    lidar.intensities.push_back(0);
  }
  return Encode(lidar);
}

// With messages lost, poses too, and scans sent twice.
Drive SomeDrive(Random& random, int64_t begin_ms, int64_t end_ms) {
  Drive drive;
  const double phase = Uniform(random, 0, 6);
  const auto send = [&](const std::string& channel, int64_t ms, const Bytes& bytes) {
    if (Chance(random, 0.03)) return;
    drive[channel].push_back({ms, bytes});
    if (Chance(random, 0.03)) drive[channel].push_back({ms, bytes});
  };
  for (int64_t ms = begin_ms; ms < end_ms; ms += 20) {
    const double angle = phase + 1e-3 * static_cast<double>(ms);
    send("POSE", ms,
         Encode(PoseMessage({milliseconds(ms), {{std::cos(angle), std::sin(2 * angle)}, angle}})));
  }
  for (const char* channel : {"LASER", "REAR"}) {
    for (int64_t ms = begin_ms + 7; ms < end_ms; ms += 90) {
      send(channel, ms, Encode(PlanarLidarMessage(milliseconds(ms), SomeRanges(random), -2, 0.3)));
    }
  }
  for (int64_t ms = begin_ms + 3; ms < end_ms; ms += 110) send("LIDAR", ms, SomeLidar(random, ms));
  return drive;
}

// Messages come late by up to so much. Each channel keeps its order.
struct Lateness {
  double scan_ms = 0;
  double pose_ms = 0;
};

Log Interleave(const Drive& drive, Lateness max, Random& random) {
  std::vector<std::pair<double, Message>> arrivals;
  for (const auto& [channel, messages] : drive) {
    const double max_ms = channel == "POSE" ? max.pose_ms : max.scan_ms;
    double arrival_ms = 0;
    for (const TimedBytes& message : messages) {
      arrival_ms =
          std::max(arrival_ms, static_cast<double>(message.ms) + Uniform(random, 0, max_ms));
      arrivals.push_back({arrival_ms, {channel, message.bytes}});
    }
  }
  std::stable_sort(arrivals.begin(), arrivals.end(),
                   [](const auto& a, const auto& b) { return a.first < b.first; });
  Log log;
  for (auto& [arrival_ms, message] : arrivals) log.push_back(std::move(message));
  return log;
}

Bytes Damaged(Random& random, Bytes bytes) {
  switch (Index(random, 3)) {
    case 0:
      bytes.resize(1 + Index(random, bytes.size()));
      break;
    case 1:
      for (int n = 0; n < 3; ++n)
        bytes[Index(random, bytes.size())] ^= static_cast<uint8_t>(1 << Index(random, 8));
      break;
    default:
      for (uint8_t& byte : bytes) byte = static_cast<uint8_t>(random());
  }
  return bytes;
}

// In all types, the time follows on the fingerprint.
Bytes StampedLongAgo(Bytes bytes) {
  if (bytes.size() >= 16) std::fill(bytes.begin() + 8, bytes.begin() + 16, uint8_t{0});
  return bytes;
}

// A log in which everything happens: messages out of order, repeated, damaged, on the wrong
// channel, stamped far ahead and long ago; and time jumps back.
Log SomeLog(Random& random) {
  Log log;
  for (size_t passes = 1 + Index(random, 3); passes > 0; --passes) {
    const auto begin_ms = static_cast<int64_t>(Uniform(random, 0, 20'000));
    const Drive drive = SomeDrive(random, begin_ms, begin_ms + 3000);
    const Log pass = Interleave(drive, {300, 300}, random);
    log.insert(log.end(), pass.begin(), pass.end());
  }
  for (size_t n = log.size() / 20; n > 0; --n) {
    const size_t k = Index(random, log.size() - 40);
    switch (Index(random, 6)) {
      case 0:
        std::swap(log[k], log[k + Index(random, 40)]);
        break;
      case 1:
        log.insert(log.begin() + static_cast<int64_t>(k + Index(random, 40)), Message(log[k]));
        break;
      case 2:
        log[k].bytes = Damaged(random, log[k].bytes);
        break;
      case 3:
        log[k].channel = log[k + 1].channel;
        break;
      case 4:
        if (Chance(random, 0.3)) log[k].bytes = StampedLongAgo(log[k].bytes);
        break;
      default:
        if (Chance(random, 0.1)) log[k].bytes[10] = 1;  // 2^40 us: twelve days ahead
    }
  }
  return log;
}

struct Mapped {
  std::map<TileKey, Tile> tiles;
  uint64_t scans = 0;
  bool operator==(const Mapped&) const = default;
};

Mapped ContentOf(const LayerSnapshot& layer) {
  Mapped mapped{{}, layer.revision};
  layer.tiles.ForEach([&](TileKey key, const TileTree::Entry& entry) {
    mapped.tiles.emplace(key, *entry.tile->Get());
  });
  return mapped;
}

// `look` is called after every message.
Mapped MapOf(
    const Log& log, DropCounts& drops,
    const std::function<void(MapWriter&, Mapper&)>& look = [](MapWriter&, Mapper&) {}) {
  MapWriter map(MapOptionsOf(ThreeScanners().method()));
  Layer& layer = map.AddLayer({"robot", 1}, {1, 1});
  Mapper mapper(ThreeScanners(), map.options(), layer);
  for (const Message& message : log) {
    mapper.HandleMessage(message.channel, message.bytes);
    look(map, mapper);
  }
  mapper.Flush();
  drops += mapper.counts().drops;
  return ContentOf(layer.Snapshot());
}

TEST(ReplayPropertyTest, WhoeverLooksOnChangesNothing) {
  DropCounts drops;
  uint64_t scans = 0;
  for (int seed = 0; seed < NumSchedules(40); ++seed) {
    Random random(seed);
    const Log log = SomeLog(random);
    const Mapped expected = MapOf(log, drops);
    std::vector<std::shared_ptr<const MapView>> kept;
    const Mapped watched = MapOf(log, drops, [&](MapWriter& map, Mapper& mapper) {
      if (Chance(random, 0.05)) kept.push_back(map.View());
      if (Chance(random, 0.05)) mapper.DrainNotices();
      if (kept.size() > 10) kept.erase(kept.begin());
    });
    EXPECT_TRUE(watched == expected) << "seed " << seed;
    scans += expected.scans;
  }
  EXPECT_GT(scans, 5'000u);
  for (const DropReason reason :
       {DropReason::kMalformedScan, DropReason::kMalformedPose, DropReason::kDuplicateScan,
        DropReason::kLateScan, DropReason::kScanWithoutPose, DropReason::kDuplicatePose}) {
    EXPECT_GT(drops[reason], 40) << DropName(reason);
  }
}

// All that a log leaves behind, in words and bytes.
std::string OutcomeOf(const Log& log, const config::Config& config, bool beside) {
  MapWriter map(MapOptionsOf(config.method()));
  Layer& layer = map.AddLayer({"robot", 1}, {1, 1});
  Mapper mapper(config, map.options(), layer);
  if (beside) mapper.MapBeside();
  for (const Message& message : log) mapper.HandleMessage(message.channel, message.bytes);
  mapper.Flush();
  const MapperCounts counts = mapper.counts();
  std::string outcome = fmt::format("{} of {} scans, {} beams\n", counts.scans_mapped,
                                    counts.scans_received, counts.beams_mapped);
  for (int k = 0; k < kNumDropReasons; ++k) {
    outcome += fmt::format("{}, ", counts.drops[static_cast<DropReason>(k)]);
  }
  outcome += fmt::format("\n{}\n", fmt::join(counts.problems, ", "));
  for (const Notice& notice : mapper.DrainNotices()) {
    outcome += fmt::format("{} times: {}\n", notice.times, notice.text);
  }
  const LayerSnapshot snapshot = mapper.Snapshot();
  for (const auto& block : snapshot.archive->Blocks()) outcome += *block->beams + block->poses;
  snapshot.tiles.ForEach([&](TileKey key, const TileTree::Entry& entry) {
    outcome += fmt::format("\n{}, {}, {}: {}", key.tx, key.ty, entry.revision,
                           TileChecksum(key, *entry.tile->Get()));
  });
  return outcome;
}

TEST(ReplayPropertyTest, MappingBesideMapsAndSaysTheSame) {
  for (int seed = 0; seed < NumSchedules(40); ++seed) {
    Random random(seed);
    const Log log = SomeLog(random);
    config::Config config = ThreeScanners();
    if (Chance(random, 0.5)) config.mutable_scan(0)->set_min_travel_m(0.1);
    if (Chance(random, 0.3)) config.mutable_service()->set_max_archive_mb(0);
    EXPECT_TRUE(OutcomeOf(log, config, true) == OutcomeOf(log, config, false)) << "seed " << seed;
  }
}

// Threads that leave the daemon's little of the machine.
class BusyMachine {
 public:
  explicit BusyMachine(size_t threads) {
    for (size_t n = 0; n < threads; ++n) {
      threads_.emplace_back([](const std::stop_token& stop) {
        while (!stop.stop_requested()) {
        }
      });
    }
  }

 private:
  std::vector<std::jthread> threads_;
};

TEST(ReplayPropertyTest, TheDaemonOnABusyMachineMapsTheSame) {
  spdlog::set_level(spdlog::level::off);  // forty daemons have much to say
  for (int seed = 0; seed < NumSchedules(8); ++seed) {
    Random random(seed);
    const Log log = SomeLog(random);
    DropCounts drops;
    const Mapped expected = MapOf(log, drops);

    const TemporaryDirectory directory;
    config::Config config = ThreeScanners();
    config.set_map(directory.File("map"));
    config.mutable_service()->set_save_interval_s(0.1);
    config.mutable_service()->set_max_queued_mb(static_cast<uint32_t>(1 + Index(random, 64)));
    auto opened = LcmBus::Open("memq://");
    ASSERT_TRUE(opened.ok()) << opened.status();
    LcmBus& bus = **opened;
    auto daemon = Daemon::Start(config, *std::move(opened));
    ASSERT_TRUE(daemon.ok()) << daemon.status();
    {
      const BusyMachine busy(Index(random, 4));
      const double pauses = Uniform(random, 0, 0.02);
      for (const Message& message : log) {
        bus.Publish(message.channel, RawMessage{message.bytes});
        if (Chance(random, pauses))
          std::this_thread::sleep_for(microseconds(Index(random, 10'000)));
        if (Chance(random, 0.01)) (*daemon)->PublishStatus();
      }
      ASSERT_TRUE((*daemon)->Stop().ok());
    }
    const auto saved = ReadMapFile(config.map());
    ASSERT_TRUE(saved.ok()) << saved.status();
    ASSERT_EQ(saved->set.layers.size(), 1u);
    EXPECT_TRUE(ContentOf(saved->set.layers[0]) == expected) << "seed " << seed;
  }
}

// The map does not depend on how channels interleave where
// * within each channel time does not step back, but for repeats of a message right after it;
// * a scan comes before any pose that is newer by max_order_wait (200 ms), counted from the scan's
//   time after its offset: else later scans of other channels need not wait for it;
// * a pose comes before the scans, of the channel that waits for it, that are newer by
// max_pose_wait
//   (2 s): else scans are dropped that poses might have bracketed;
// * nothing overtakes a jump in time, which ends all waiting;
// * no more scans and poses wait than their bounds allow.
// What cannot be decoded has no say in any of this.
constexpr Lateness kWithinBounds = {150, 1500};

Mapped MapOfPasses(const std::vector<Drive>& passes, Lateness max, Random& random) {
  Log log;
  for (const Drive& drive : passes) {
    const Log pass = Interleave(drive, max, random);
    log.insert(log.end(), pass.begin(), pass.end());
  }
  DropCounts drops;
  return MapOf(log, drops);
}

// A drive, part of it once more, and garbage.
std::vector<Drive> SomePasses(Random& random) {
  std::vector<Drive> passes = {SomeDrive(random, 10'000, 14'000), SomeDrive(random, 2'000, 5'000)};
  for (Drive& drive : passes) {
    for (auto& [channel, messages] : drive) {
      const size_t k = Index(random, messages.size());
      const TimedBytes garbage{messages[k].ms, Bytes(1 + Index(random, 200), 0x5a)};
      messages.insert(messages.begin() + static_cast<int64_t>(k), garbage);
    }
  }
  return passes;
}

TEST(ReplayPropertyTest, TheInterleavingOfChannelsDoesNotMatter) {
  uint64_t scans = 0;
  for (int seed = 0; seed < NumSchedules(20); ++seed) {
    Random random(seed);
    const std::vector<Drive> passes = SomePasses(random);
    const Mapped expected = MapOfPasses(passes, {0, 0}, random);
    for (int n = 0; n < 3; ++n) {
      EXPECT_TRUE(MapOfPasses(passes, kWithinBounds, random) == expected) << "seed " << seed;
    }
    scans += expected.scans;
  }
  EXPECT_GT(scans, 3'000u);
}

TEST(ReplayPropertyTest, StampsOfLongAgoChangeNothingElse) {
  for (int seed = 0; seed < NumSchedules(20); ++seed) {
    Random random(seed);
    DropCounts drops;
    Log log = Interleave(SomeDrive(random, 10'000, 14'000), {300, 300}, random);
    const Mapped expected = MapOf(log, drops);
    for (int n = 0; n < 20; ++n) {
      const size_t k = Index(random, log.size());
      // Behind a message of its channel: what comes first sets the time.
      log.insert(log.begin() + static_cast<int64_t>(k) + 1,
                 {log[k].channel, StampedLongAgo(log[k].bytes)});
    }
    EXPECT_TRUE(MapOf(log, drops) == expected) << "seed " << seed;
  }
}

TEST(ReplayPropertyTest, BeyondTheWaitsItDoes) {
  int scans_too_late = 0;
  int poses_too_late = 0;
  for (int seed = 0; seed < 20; ++seed) {
    Random random(seed);
    const std::vector<Drive> passes = SomePasses(random);
    const Mapped expected = MapOfPasses(passes, {0, 0}, random);
    scans_too_late += MapOfPasses(passes, {600, 0}, random) != expected;
    poses_too_late += MapOfPasses(passes, {0, 4000}, random) != expected;
  }
  EXPECT_GT(scans_too_late, 15);
  EXPECT_GT(poses_too_late, 15);
}

}  // namespace splinemap::replay_property_test
