// Kills processes that write map files, at random instants, and reads what they leave; see
// README.md.
#include <signal.h>
#include <sys/mman.h>
#include <sys/wait.h>
#include <unistd.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <array>
#include <atomic>
#include <chrono>
#include <filesystem>
#include <fstream>
#include <functional>
#include <random>
#include <string>
#include <thread>
#include <vector>

#include "fmt/format.h"
#include "lib/base/file.h"
#include "lib/base/status.h"
#include "lib/tiles/tile_memory.h"
#include "splinemap/file.h"
#include "tests/fault/map_history.h"
#include "tests/support/random_map.h"
#include "tests/support/shared_data.h"
#include "tests/support/temporary_directory.h"

namespace splinemap {
namespace {

using Seconds = std::chrono::duration<double>;

double SecondsSince(std::chrono::steady_clock::time_point start) {
  return Seconds(std::chrono::steady_clock::now() - start).count();
}

// What the killed process has saved, in memory that both see.
struct Progress {
  static constexpr uint32_t kMax = 4096;
  std::atomic<uint32_t> begun;
  std::atomic<uint32_t> done;
  std::array<uint64_t, kMax> fingerprints;

  void Begin(uint64_t fingerprint) {
    fingerprints[0] = fingerprint;
    begun = 1;
    done = 1;
  }
  template <typename Save>
  bool Try(const LayerSet& set, Save save) {
    if (begun == kMax) return false;
    fingerprints[begun] = FingerprintOf(set);
    ++begun;
    if (!save()) _exit(1);
    done = begun.load();
    return true;
  }
};

// Does something to the file until it is killed, or has done it often enough.
using Work = std::function<void(const std::string& path, uint64_t seed, Progress& progress)>;

// As a daemon whose map is larger than its memory.
absl::StatusOr<MapFile> OpenWithLittleMemory(const std::string& path) {
  constexpr size_t kMaxTiles = 8;
  return MapFile::Open(path, std::make_shared<TileMemory>(kMaxTiles));
}

void Save(const std::string& path, uint64_t seed, Progress& progress) {
  auto file = OpenWithLittleMemory(path);
  if (!file.ok()) _exit(1);
  const auto loaded = file->Load();
  if (!loaded.ok()) _exit(1);
  LayerSet set = loaded->set;
  for (auto n = static_cast<int>(seed % 1000);; ++n) {
    set = OneMoreCommit(set, n);
    if (!progress.Try(set, [&] { return file->Save(set).ok(); })) return;
    if (n % 20 != 0) continue;
    if (!file->Close().ok()) _exit(1);
    file = absl::UnknownError("closed");
    file = OpenWithLittleMemory(path);
    if (!file.ok() || !file->Load().ok()) _exit(1);
  }
}

void SaveFolds(const std::string& path, uint64_t seed, Progress& progress) {
  auto file = OpenWithLittleMemory(path);
  if (!file.ok()) _exit(1);
  MapHistory history(seed);
  for (int k = 0; k < 10; ++k) history.Next();
  LayerSet set = history.Next();
  while (progress.Try(set, [&] { return file->Save(set).ok(); })) set = history.NextCorrected();
}

void Replace(const std::string& path, uint64_t seed, Progress& progress) {
  MapHistory history(seed);
  LayerSet set = history.Next();
  const auto save = [&] {
    const std::string part = TemporaryPathFor(path);
    auto file = MapFile::Open(part);
    return file.ok() && file->Save(set).ok() && file->Close().ok() &&
           MapFile::Rename(part, path).ok();
  };
  while (progress.Try(set, save)) set = history.Next();
}

// Of a file that is the same all the time.
void BackUp(const std::string& path, uint64_t, Progress& progress) {
  while (true) {
    const auto loaded = ReadMapFile(path);
    if (!loaded.ok() || progress.fingerprints[0] != FingerprintOf(loaded->set)) _exit(1);
    const std::string part = TemporaryPathFor(path + ".copy");
    auto file = MapFile::Open(part);
    if (!file.ok() || !file->Save(loaded->set).ok() || !file->Close().ok() ||
        !MapFile::Rename(part, path + ".copy").ok()) {
      _exit(1);
    }
  }
}

struct Kind {
  const char* name;
  Work work;
  bool begins_old = false;  // in a file of an older schema, which is upgraded
  const char* other_file = "";
};

const std::vector<Kind> kKinds{{"saving", Save},
                               {"saving folds", SaveFolds},
                               {"replacing (merge, fold, build)", Replace},
                               {"upgrading an old schema", Save, true},
                               {"backup", BackUp, false, ".copy"}};

struct Tally {
  size_t tried = 0;
  size_t survived = 0;
  uint32_t max_lost = 0;
  double slowest_s = 0;
};

class Kills {
 public:
  Kills(size_t kills, uint64_t seed) : kills_(kills), random_(seed) {
    progress_ = static_cast<Progress*>(
        mmap(nullptr, sizeof(Progress), PROT_READ | PROT_WRITE, MAP_SHARED | MAP_ANONYMOUS, -1, 0));
  }

  bool Run() {
    fmt::print("{:<34}{:>8}{:>10}{:>18}{:>18}\n", "killed while", "tried", "survived",
               "saves lost, most", "opens in, most");
    bool is_right = true;
    for (const Kind& kind : kKinds) {
      Tally tally;
      while (tally.tried < kills_ / kKinds.size()) KillOne(kind, tally);
      fmt::print("{:<34}{:>8}{:>10}{:>18}{:>16.3f} s\n", kind.name, tally.tried, tally.survived,
                 tally.max_lost, tally.slowest_s);
      std::fflush(stdout);
      is_right = is_right && tally.survived == tally.tried;
    }
    return is_right;
  }

 private:
  // The file goes on from kill to kill; now and then it begins anew.
  void KillOne(const Kind& kind, Tally& tally) {
    if (kind.begins_old || tally.tried % 50 == 0) BeginAnew(kind);
    const uint64_t seed = random_();
    std::uniform_real_distribution<double> delay_s(0, 0.03);
    const pid_t child = fork();
    if (child == 0) {
      kind.work(path_, seed, *progress_);
      _exit(0);
    }
    std::this_thread::sleep_for(Seconds(delay_s(random_)));
    kill(child, SIGKILL);
    int status = 0;
    waitpid(child, &status, 0);
    ++tally.tried;
    if (WIFEXITED(status)) {
      fmt::print("    {}: ended by itself, status {}\n", kind.name, WEXITSTATUS(status));
      return;
    }
    Check(kind, tally);
  }

  void BeginAnew(const Kind& kind) {
    for (const auto& entry : std::filesystem::directory_iterator(folder_.path())) {
      std::filesystem::remove(entry);
    }
    if (kind.begins_old) {
      std::filesystem::copy_file(TestData("map_of_schema_2"), path_);
      return progress_->Begin(FingerprintOf(ReadMapFile(path_)->set));
    }
    MapHistory history(random_());
    for (int k = 0; k < 20; ++k) history.Next();
    const LayerSet set = history.Next();
    MapFile::Open(path_)->Save(set).IgnoreError();
    progress_->Begin(FingerprintOf(set));
  }

  void Check(const Kind& kind, Tally& tally) {
    const auto start = std::chrono::steady_clock::now();
    auto file = OpenWithLittleMemory(path_ + kind.other_file);
    const auto loaded = file.ok() ? file->Load() : file.status();
    tally.slowest_s = std::max(tally.slowest_s, SecondsSince(start));
    if (kind.other_file[0] != '\0') {
      const bool is_none = absl::IsNotFound(loaded.status());
      if (is_none) MapFile::Remove(path_ + kind.other_file);
      const bool is_whole = loaded.ok() && loaded->corruption.empty() &&
                            FingerprintOf(loaded->set) == progress_->fingerprints[0];
      tally.survived += is_none || is_whole ? 1 : 0;
      return;
    }
    if (!loaded.ok() || !loaded->corruption.empty()) {
      fmt::print("    {}: {}\n", kind.name,
                 loaded.ok() ? loaded->corruption.front() : ErrorText(loaded.status()));
      return;
    }
    const uint64_t found = FingerprintOf(loaded->set);
    for (uint32_t k = progress_->begun; k-- > 0;) {
      if (progress_->fingerprints[k] != found) continue;
      const uint32_t done = progress_->done;
      if (k + 1 >= done) ++tally.survived;
      if (k + 1 < done) tally.max_lost = std::max(tally.max_lost, done - k - 1);
      progress_->Begin(found);
      return;
    }
    fmt::print("    {}: a map that nobody saved\n", kind.name);
  }

  const size_t kills_;
  std::mt19937_64 random_;
  Progress* progress_ = nullptr;
  const TemporaryDirectory folder_;
  const std::string path_ = folder_.File("map.splinemap");
};

// How long a file of so many tiles takes to open after a kill in its first save, as the next daemon
// does it, and where a page of it is damaged besides.
void PrintRecovery() {
  fmt::print("\n{:>8}{:>12}{:>22}{:>22}\n", "tiles", "file, MB", "opens after kill, s",
             "with damage, s");
  for (const int side : {30, 100, 300}) {
    const TemporaryDirectory folder;
    const std::string path = folder.File("map.splinemap");
    const pid_t child = fork();
    if (child == 0) {
      std::mt19937_64 random(1);
      MapWriter map{{0.05, {-2560, 5120}}};
      Layer& layer = map.AddLayer({"robot", 1}, {1, 1});
      layer.BeginCommit();
      const Tile tile = RandomTile(random, map.options().limits);
      for (int k = 0; k < side * side; ++k) {
        Tile& edited = layer.EditTile({k % side, k / side});
        edited = tile;
        for (int n = 0; n < 100; ++n) {
          edited.control_points[random() % edited.control_points.size()] =
              static_cast<ControlPoint>(random() % 2000);
        }
      }
      MapFile file = *MapFile::Open(path);
      file.Save(map.Layers()).IgnoreError();
      kill(getpid(), SIGKILL);
    }
    waitpid(child, nullptr, 0);
    auto start = std::chrono::steady_clock::now();
    const auto open = [&] {
      start = std::chrono::steady_clock::now();
      auto file = MapFile::Open(path);
      const auto loaded = file->Load();
      return loaded.ok() ? SecondsSince(start) : -1;
    };
    const double after_kill_s = open();
    const auto bytes = std::filesystem::file_size(path);
    {
      std::fstream damaged(path, std::ios::in | std::ios::out | std::ios::binary);
      damaged.seekp(static_cast<std::streamoff>(bytes / 2 / 4096 * 4096));
      damaged << std::string(4096, '\xa5');
    }
    fmt::print("{:>8}{:>12.1f}{:>22.3f}{:>22.3f}\n", side * side, static_cast<double>(bytes) / 1e6,
               after_kill_s, open());
  }
}

int Main(int argc, char** argv) {
  CLI::App app("Kills processes that write map files, at random instants");
  size_t kills = 200;
  uint64_t seed = 1;
  bool with_recovery = false;
  app.add_option("--kills", kills, "How many")->capture_default_str();
  app.add_option("--seed", seed, "Of all that is random")->capture_default_str();
  app.add_flag("--recovery", with_recovery, "Prints how long opening takes, by size of the map");
  CLI11_PARSE(app, argc, argv);
  const bool is_right = Kills(kills, seed).Run();
  if (with_recovery) PrintRecovery();
  return is_right ? 0 : 1;
}

}  // namespace
}  // namespace splinemap

int main(int argc, char** argv) { return splinemap::Main(argc, argv); }
