// What three NATS servers have acknowledged is there after one of them was killed; see README.md.
#include <CLI/CLI.hpp>
#include <algorithm>
#include <chrono>
#include <map>
#include <memory>
#include <nlohmann/json.hpp>
#include <random>
#include <string>
#include <thread>
#include <vector>

#include "absl/strings/numbers.h"
#include "fmt/format.h"
#include "lib/base/clock.h"
#include "lib/base/mutex.h"
#include "lib/base/status.h"
#include "lib/fleet/fleet_address.h"
#include "lib/fleet/nats_fleet_store.h"
#include "tests/support/nats_server.h"

namespace splinemap {
namespace {

using std::chrono::milliseconds;
using std::chrono::seconds;

constexpr int kFirstPort = 4531;
constexpr int kKeys = 200;
constexpr int kSkipped = 77;  // the version of the servers is known to lose
constexpr size_t kMostPerBatch = 24;
// Servers choose another leader after 4 to 9 s.
constexpr seconds kPatience(90);
// Between batches. Servers that were away do not catch up with writes as fast as they are taken.
constexpr milliseconds kRest(20);
// nats-server 2.9.10 loses values more often where a leader that was killed is back sooner.
constexpr milliseconds kAway(11'000);

// Its number, and some kB that are made of it.
std::string ValueOf(uint64_t number) {
  std::mt19937_64 random(number);
  std::string value = fmt::format("{:016x}", number);
  for (size_t words = 250 + random() % 750; words > 0; --words) {
    value += fmt::format("{:x}", random() & 0xffff);
  }
  return value;
}

// 0 where it is no value that was written.
uint64_t NumberOf(const std::string& value) {
  uint64_t number = 0;
  return absl::SimpleHexAtoi(value.substr(0, 16), &number) && value == ValueOf(number) ? number : 0;
}

std::string KeyOf(int key) { return fmt::format("numbers.{}", key); }

// What a writer knows of each key.
struct Written {
  uint64_t acknowledged = 0;
  uint64_t tried = 0;
};

// Writes growing numbers to all keys, in batches, and notes what was acknowledged. Of one batch
// that failed nobody knows what was written.
class Writer {
 public:
  Writer(const FleetAddress& address, uint64_t seed)
      : store_(*NatsFleetStore::Connect(address)),
        random_(seed),
        writing_([this](const std::stop_token& stop) { Run(stop); }) {}

  std::map<int, Written> written() const {
    MutexLock lock(mutex_);
    return written_;
  }
  struct Counts {
    int64_t tried = 0;
    int64_t acknowledged = 0;
    int64_t failed_batches = 0;
  };
  Counts counts() const {
    MutexLock lock(mutex_);
    return counts_;
  }
  void End() { writing_ = {}; }

 private:
  void Run(const std::stop_token& stop) {
    while (!stop.stop_requested()) {
      std::map<int, uint64_t> batch;
      for (size_t k = 1 + random_() % kMostPerBatch; k > 0; --k) {
        batch[static_cast<int>(random_() % kKeys)] = ++last_number_;
      }
      Write(batch);
      std::this_thread::sleep_for(kRest);
    }
  }

  void Write(const std::map<int, uint64_t>& batch) {
    std::vector<FleetEntry> entries;
    {
      MutexLock lock(mutex_);
      for (const auto& [key, number] : batch) {
        written_[key].tried = number;
        entries.push_back({KeyOf(key), ValueOf(number), number});
      }
      counts_.tried += std::ssize(batch);
    }
    const bool is_ok = store_->Put(entries).ok();
    MutexLock lock(mutex_);
    if (is_ok) {
      for (const auto& [key, number] : batch) written_[key].acknowledged = number;
      counts_.acknowledged += std::ssize(batch);
    } else {
      ++counts_.failed_batches;
    }
  }

  const std::unique_ptr<NatsFleetStore> store_;
  std::mt19937_64 random_;    // of the thread
  uint64_t last_number_ = 0;  // the same
  mutable Mutex mutex_;
  std::map<int, Written> written_ ABSL_GUARDED_BY(mutex_);
  Counts counts_ ABSL_GUARDED_BY(mutex_);
  std::jthread writing_;
};

class Faults {
 public:
  Faults(uint64_t seed, bool is_hasty) : random_(seed), seed_(seed), is_hasty_(is_hasty) {}

  // The exit status of the program.
  int Run(seconds duration) {
    store_ = *NatsFleetStore::Connect(Address());
    if (!Await([&] { return store_->MakeBucket(NatsCluster::kServers).ok() && IsWhole(); })) {
      return Fail("the servers do not begin");
    }
    const auto version = ServerVersion(Address());
    if (!version.ok()) return Fail(ErrorText(version.status()));
    Writer writer(Address(), seed_);
    bool is_whole = true;
    for (const auto end = Clock::now() + duration; is_whole && lost_ == 0 && Clock::now() < end;) {
      std::this_thread::sleep_for(milliseconds(random_() % 500));
      const std::string killed = KillOne();
      // Who is behind counts as killed: another may be killed when it has caught up.
      is_whole = Await([&] { return IsWhole(); });
      if (is_whole) lost_ = NumLess(writer);
      if (lost_ > 0) {
        fmt::print(stderr, "kill {}, of {}: {} of {} keys have less than was acknowledged\n",
                   kills_, killed, lost_, kKeys);
      }
    }
    writer.End();
    const Writer::Counts counts = writer.counts();
    fmt::print(
        "nats-server {}: {} writes, {} acknowledged, {} batches failed; {} kills, {} of leaders, "
        "{} "
        "with all that was stored; {} values read; lost: {}\n",
        *version, counts.tried, counts.acknowledged, counts.failed_batches, kills_,
        kills_of_leader_, wipes_, values_read_, lost_);
    if (!is_whole) return Fail("the servers do not get whole again");
    if (kills_of_leader_ == 0) return Fail("no leader was killed");
    if (lost_ == 0) return 0;
    // Later ones may lose where power fails, but not here.
    if (!version->starts_with("2.9.")) return Fail("what was acknowledged is lost");
    fmt::print("skipped: {}\n", WhatServerMayLose(*version));
    return kSkipped;
  }

 private:
  static int Fail(const std::string& what) {
    fmt::print(stderr, "FAILED: {}\n", what);
    return 1;
  }

  FleetAddress Address() const {
    FleetAddress address;
    address.servers = cluster_.urls();
    address.program = "acknowledged";
    return address;
  }

  template <typename Condition>
  static bool Await(Condition is_met) {
    for (const auto end = Clock::now() + kPatience; Clock::now() < end;) {
      if (is_met()) return true;
      std::this_thread::sleep_for(milliseconds(50));
    }
    return false;
  }

  // What the servers say of the bucket's stream; null where nobody does.
  nlohmann::json StateOfCluster() const {
    const auto reply = store_->Request("$JS.API.STREAM.INFO." + Address().Stream(), "", seconds(1));
    if (!reply.ok()) return {};
    return nlohmann::json::parse(*reply, nullptr, false).value("cluster", nlohmann::json());
  }
  bool IsWhole() const {
    const nlohmann::json cluster = StateOfCluster();
    if (!cluster.is_object() || cluster.value("leader", "").empty()) return false;
    const nlohmann::json replicas = cluster.value("replicas", nlohmann::json::array());
    return replicas.size() == NatsCluster::kServers - 1 &&
           std::all_of(replicas.begin(), replicas.end(), [](const nlohmann::json& replica) {
             return replica.value("current", false) && !replica.value("offline", false);
           });
  }

  // Returns which.
  std::string KillOne() {
    const nlohmann::json cluster = StateOfCluster();
    const std::string leader = cluster.is_object() ? cluster.value("leader", "") : "";
    int server = static_cast<int>(random_() % NatsCluster::kServers);
    if (kills_of_leader_ == 0 || random_() % 2 == 0) {
      for (int k = 0; k < NatsCluster::kServers; ++k) {
        if (NatsCluster::NameOf(k) == leader) server = k;
      }
    }
    const bool is_leader = NatsCluster::NameOf(server) == leader;
    const bool forgets = random_() % 3 == 0;
    cluster_.Kill(server);
    if (forgets) cluster_.Forget(server);
    std::this_thread::sleep_for((is_hasty_ ? milliseconds(0) : kAway) +
                                milliseconds(random_() % 1500));
    cluster_.Start(server);
    ++kills_;
    kills_of_leader_ += is_leader;
    wipes_ += forgets;
    return fmt::format("{}{}{}", NatsCluster::NameOf(server), is_leader ? ", the leader" : "",
                       forgets ? ", whose folder was deleted" : "");
  }

  // How many keys have neither what was acknowledged nor what was tried later. Writing goes on
  // meanwhile.
  int64_t NumLess(const Writer& writer) {
    int64_t less = 0;
    for (const auto& [key, known] : writer.written()) {
      if (known.acknowledged == 0) continue;
      absl::StatusOr<FleetEntry> entry;
      // A leader answers, but for the moments without one.
      Await([&] {
        entry = store_->Get(KeyOf(key));
        return !absl::IsUnavailable(entry.status());
      });
      ++values_read_;
      const uint64_t number = entry.ok() ? NumberOf(entry->value) : 0;
      less += number < known.acknowledged || number > writer.written().at(key).tried;
    }
    return less;
  }

  std::mt19937_64 random_;
  const uint64_t seed_;
  const bool is_hasty_;
  NatsCluster cluster_{kFirstPort};
  std::unique_ptr<NatsFleetStore> store_;
  int64_t kills_ = 0;
  int64_t kills_of_leader_ = 0;
  int64_t wipes_ = 0;
  int64_t values_read_ = 0;
  int64_t lost_ = 0;
};

int Main(int argc, char** argv) {
  CLI::App app("Kills NATS servers, one of three at a time, while values are written and read");
  int duration_s = 15;
  uint64_t seed = 1;
  bool is_hasty = false;
  app.add_option("--seconds", duration_s, "How long")->capture_default_str();
  app.add_option("--seed", seed, "Of all that is random")->capture_default_str();
  app.add_flag("--hasty", is_hasty, "Starts servers again at once");
  CLI11_PARSE(app, argc, argv);
  return Faults(seed, is_hasty).Run(seconds(duration_s));
}

}  // namespace
}  // namespace splinemap

int main(int argc, char** argv) { return splinemap::Main(argc, argv); }
