// Cuts the power of a disk at every instant of what is done to map files, and lets every operation
// on the disk fail; see README.md.
#include <sqlite3.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <array>
#include <filesystem>
#include <fstream>
#include <functional>
#include <map>
#include <optional>
#include <random>
#include <string>
#include <vector>

#include "fmt/format.h"
#include "lib/base/file.h"
#include "lib/base/status.h"
#include "splinemap/file.h"
#include "tests/fault/disk_log.h"
#include "tests/fault/map_history.h"
#include "tests/support/shared_data.h"
#include "tests/support/temporary_directory.h"

namespace splinemap {
namespace {

using Unsynced = DiskLog::Unsynced;
using Failure = DiskLog::Failure;

// What was saved in which order, and between which instants of the disk.
class Saves {
 public:
  struct State {
    uint64_t fingerprint;
    size_t begun;
    std::optional<size_t> done;  // none: it failed
  };
  // What is there at the beginning.
  void Have(const LayerSet& set) { states_.push_back({FingerprintOf(set), 0, 0}); }
  template <typename Save>
  bool Try(const LayerSet& set, Save save) {
    states_.push_back({FingerprintOf(set), DiskLog::Get().size(), std::nullopt});
    const size_t index = states_.size() - 1;
    const bool is_saved = save();
    if (is_saved) states_[index].done = DiskLog::Get().size();
    return is_saved;
  }

  // Somebody deletes what was saved.
  void Lose() { states_.push_back({0, DiskLog::Get().size(), DiskLog::Get().size()}); }

  // The last state that was saved whole by then; none where there need not be any.
  std::optional<size_t> LastDone(size_t instant) const {
    std::optional<size_t> last;
    for (size_t k = 0; k < states_.size(); ++k) {
      if (!states_[k].done || *states_[k].done > instant) continue;
      last = states_[k].fingerprint != 0 ? std::optional(k) : std::nullopt;
    }
    return last;
  }
  // Which state this is, of those that had been begun; none where it is none.
  std::optional<size_t> IndexOf(uint64_t fingerprint, size_t instant) const {
    std::optional<size_t> found;
    for (size_t k = 0; k < states_.size(); ++k) {
      if (states_[k].fingerprint == fingerprint && states_[k].begun <= instant) found = k;
    }
    return found;
  }

 private:
  std::vector<State> states_;
};

// Something that is done to the file `path`, after what makes it what it is before.
struct Scenario {
  std::string name;
  std::function<void(const std::string& path, Saves& saves)> prepare;
  std::function<void(const std::string& path, uint64_t seed, Saves& saves)> run;
};

bool Save(MapFile& file, const LayerSet& set, Saves& saves) {
  return saves.Try(set, [&] { return file.Save(set).ok(); });
}

// As commands make a map file.
bool SaveAs(const std::string& path, const LayerSet& set, Saves& saves) {
  return saves.Try(set, [&] {
    const std::string part = TemporaryPathFor(path);
    const bool is_made = MapFile::WriteNew(part, set).ok() && MapFile::Rename(part, path).ok();
    MapFile::Remove(part);
    return is_made;
  });
}

// The map of a daemon that was killed: the last save is in the -wal alone, since somebody read.
LayerSet MakeKilled(const std::string& path) {
  const TemporaryDirectory elsewhere;
  const std::string alive = elsewhere.File("alive");
  MapHistory history(3);
  auto file = MapFile::Open(alive);
  LayerSet set;
  for (int k = 0; k < 5; ++k) {
    set = history.Next();
    file->Save(set).IgnoreError();
  }
  sqlite3* reader = nullptr;
  sqlite3_open(alive.c_str(), &reader);
  sqlite3_exec(reader, "BEGIN; SELECT count(*) FROM tile", nullptr, nullptr, nullptr);
  for (int k = 0; k < 3; ++k) {
    set = history.Next();
    file->Save(set).IgnoreError();
  }
  for (const char* beside : {"", "-wal"}) std::filesystem::copy_file(alive + beside, path + beside);
  sqlite3_close(reader);
  return set;
}

// The same with a page that is damaged; returns what can be read of it.
LayerSet MakeDamaged(const std::string& path) {
  MakeKilled(path);
  std::fstream file(path, std::ios::in | std::ios::out | std::ios::binary);
  file.seekp(static_cast<std::streamoff>(std::filesystem::file_size(path) / 2 / 4096 * 4096));
  file << std::string(4096, '\xa5');
  file.close();
  return ReadMapFile(path)->set;
}

// A file that was left while SQLite wrote to it with a journal beside.
LayerSet MakeWithJournal(const std::string& path) {
  const LayerSet set = MakeKilled(path);
  MapFile::Open(path)->Close().IgnoreError();
  const std::string left = path + ".left";
  sqlite3* writer = nullptr;
  sqlite3_open(path.c_str(), &writer);
  sqlite3_exec(writer, "PRAGMA cache_size = 1; BEGIN; DELETE FROM tile", nullptr, nullptr, nullptr);
  sqlite3_exec(writer, "UPDATE layer SET name = 'half'", nullptr, nullptr, nullptr);
  for (const char* beside : {"", "-journal"}) {
    std::filesystem::copy_file(path + beside, left + beside);
  }
  sqlite3_close(writer);
  for (const char* beside : {"", "-journal"}) {
    std::filesystem::rename(left + beside, path + beside);
  }
  return set;
}

void MakeOldSchema(const std::string& path, Saves& saves) {
  std::filesystem::copy_file(TestData("map_of_schema_2"), path);
  saves.Have(ReadMapFile(path)->set);
}

// Opens, and goes on for some saves, as a daemon does; `reader` ends before it does.
void GoOnBeside(sqlite3* reader, const std::string& path, uint64_t seed, Saves& saves) {
  auto file = MapFile::Open(path);
  if (!file.ok()) return;
  const auto loaded = file->Load();
  if (!loaded.ok()) return;
  LayerSet set = loaded->set;
  for (int k = 0; k < 3; ++k) {
    set = OneMoreCommit(set, static_cast<int>(seed % 1000) + k);
    Save(*file, set, saves);
  }
  sqlite3_close(reader);
}
void GoOn(const std::string& path, uint64_t seed, Saves& saves) {
  GoOnBeside(nullptr, path, seed, saves);
}

std::vector<Scenario> Scenarios() {
  const auto nothing = [](const std::string&, Saves&) {};
  const auto killed = [](const std::string& path, Saves& saves) { saves.Have(MakeKilled(path)); };
  const auto journal = [](const std::string& path, Saves& saves) {
    saves.Have(MakeWithJournal(path));
  };
  const auto damaged = [](const std::string& path, Saves& saves) { saves.Have(MakeDamaged(path)); };
  const auto replace = [](const std::string& path, uint64_t seed, Saves& saves) {
    SaveAs(path, MapHistory(seed + 5).Next(), saves);
  };
  return {
      {"first saves", nothing,
       [](const std::string& path, uint64_t seed, Saves& saves) {
         MapHistory history(seed);
         auto file = MapFile::Open(path);
         if (!file.ok()) return;
         for (int k = 0; k < 3; ++k) Save(*file, history.Next(), saves);
       }},
      {"saves", nothing,
       [](const std::string& path, uint64_t seed, Saves& saves) {
         MapHistory history(seed);
         auto file = MapFile::Open(path);
         if (!file.ok()) return;
         for (int k = 0; k < 9; ++k) Save(*file, history.Next(), saves);
         file = absl::UnknownError("closed");
         GoOn(path, seed, saves);
       }},
      {"corrections", nothing,
       [](const std::string& path, uint64_t seed, Saves& saves) {
         MapHistory history(seed);
         for (int k = 0; k < 12; ++k) history.Next();
         auto file = MapFile::Open(path);
         if (!file.ok()) return;
         for (int k = 0; k < 4; ++k) Save(*file, history.NextCorrected(), saves);
       }},
      {"reader beside", killed,
       [](const std::string& path, uint64_t seed, Saves& saves) {
         sqlite3* reader = nullptr;
         sqlite3_open(path.c_str(), &reader);
         sqlite3_exec(reader, "BEGIN; SELECT count(*) FROM tile", nullptr, nullptr, nullptr);
         GoOnBeside(reader, path, seed, saves);
       }},
      {"after a kill", killed, GoOn},
      {"journal left", journal, GoOn},
      {"old schema", MakeOldSchema, GoOn},
      {"damaged", damaged, GoOn},
      {"new file", nothing, replace},
      {"replace", killed, replace},
      {"replace, journal", journal, replace},
      {"replace, damaged", damaged, replace},
      {"deleted meanwhile", nothing,
       [](const std::string& path, uint64_t seed, Saves& saves) {
         MapHistory history(seed);
         auto file = MapFile::Open(path);
         if (!file.ok() || !Save(*file, history.Next(), saves)) return;
         std::filesystem::remove(path);
         saves.Lose();
         const LayerSet set = history.Next();
         if (!saves.Try(set, [&] { return file->SaveElsewhere(path, set).ok(); })) return;
         Save(*file, history.Next(), saves);
       }},
  };
}

// Of one kind of fault.
struct Tally {
  size_t tried = 0;
  size_t newest = 0;      // the last state that was saved, or a later one
  size_t older = 0;       // an older one
  size_t max_lost = 0;    // saves
  size_t named = 0;       // said to be damaged
  size_t unreadable = 0;  // said to be no map, or to hold none
  std::vector<std::string> wrong;
};

// Reads what is left of the file as the next daemon does, and goes on with it.
void Check(const std::string& path, size_t instant, const Saves& saves, bool goes_on,
           const std::string& what, Tally& tally) {
  ++tally.tried;
  const std::optional<size_t> last = saves.LastDone(instant);
  const auto wrong = [&](const std::string& why) { tally.wrong.push_back(what + ": " + why); };
  auto file = MapFile::Open(path);
  absl::StatusOr<LoadedMap> loaded = file.ok() ? file->Load() : file.status();
  if (!loaded.ok()) {
    ++tally.unreadable;
    if (last || !absl::IsNotFound(loaded.status())) wrong(ErrorText(loaded.status()));
  } else if (const auto index = saves.IndexOf(FingerprintOf(loaded->set), instant)) {
    if (last && *index < *last) {
      ++tally.older;
      tally.max_lost = std::max(tally.max_lost, *last - *index);
      wrong(fmt::format("{} saves are lost", *last - *index));
    } else {
      ++tally.newest;
    }
  } else if (!loaded->corruption.empty()) {
    ++tally.named;
    if (last) wrong(loaded->corruption.front());
  } else {
    wrong("a map that nobody saved");
  }
  if (!goes_on || !file.ok()) return;
  const LayerSet next = loaded.ok() && !loaded->set.layers.empty()
                            ? OneMoreCommit(loaded->set, static_cast<int>(instant))
                            : MapHistory(instant).Next();
  const auto saved = file->Save(next);
  if (!saved.ok()) return wrong("cannot go on: " + ErrorText(saved.status()));
  file = absl::UnknownError("closed");
  const auto again = ReadMapFile(path);
  if (!again.ok() || !again->corruption.empty()) {
    wrong("what it goes on with is damaged: " +
          (again.ok() ? again->corruption.front() : ErrorText(again.status())));
  } else if (FingerprintOf(again->set) != FingerprintOf(next)) {
    wrong("what it goes on with is not kept");
  }
}

void Print(const std::string& name, const Tally& tally) {
  fmt::print("{:<34}{:>8}{:>9}{:>8}{:>10}{:>8}{:>12}{:>7}\n", name, tally.tried, tally.newest,
             tally.older, tally.max_lost, tally.named, tally.unreadable, tally.wrong.size());
  for (size_t k = 0; k < std::min<size_t>(tally.wrong.size(), 3); ++k) {
    fmt::print("    {}\n", tally.wrong[k]);
  }
  std::fflush(stdout);
}

class Faults {
 public:
  Faults(size_t cuts, uint64_t seed, std::string only)
      : cuts_(cuts), seed_(seed), only_(std::move(only)) {}

  // True where everything went as promised.
  bool Run() {
    fmt::print("{:<34}{:>8}{:>9}{:>8}{:>10}{:>8}{:>12}{:>7}\n", "", "tried", "newest", "older",
               "lost most", "named", "unreadable", "wrong");
    const std::vector<Scenario> scenarios = Scenarios();
    const size_t share = cuts_ / scenarios.size();
    for (const Scenario& scenario : scenarios) {
      if (!only_.empty() && scenario.name != only_) continue;
      CutHonest(scenario, share * 3 / 4);
      CutLying(scenario, share / 4);
      Fail(scenario, share / 4);
    }
    if (only_.empty()) CutNewFile();
    fmt::print("\n");
    for (const auto& [fault, total] : totals_) Print("all: " + fault, total);
    return is_right_;
  }

 private:
  static constexpr const char* kName = "/map.splinemap";

  void Prepare(const Scenario& scenario, const std::string& folder, Saves& saves) {
    DiskLog::Get().End();
    for (const auto& entry : std::filesystem::directory_iterator(folder)) {
      std::filesystem::remove_all(entry);
    }
    scenario.prepare(folder + kName, saves);
    DiskLog::Get().Begin(folder);
  }

  // Every instant, as often as there is room for.
  void CutHonest(const Scenario& scenario, size_t cuts) {
    Tally tally;
    for (uint64_t round = 0; tally.tried < cuts; ++round) {
      Saves saves;
      Prepare(scenario, live_.path(), saves);
      scenario.run(live_.path() + kName, seed_ + round, saves);
      const size_t instants = DiskLog::Get().size();
      // Some beyond the cuts that are left, in steps, so that every round covers all of it.
      const size_t step = 1 + 3 * instants / std::max<size_t>(cuts - tally.tried, 1);
      for (size_t instant = round % step; instant <= instants; instant += step) {
        for (const Unsynced unsynced : {Unsynced::kLost, Unsynced::kKept, Unsynced::kAny}) {
          CutAt({.instant = instant, .unsynced = unsynced}, round, saves, tally);
        }
      }
    }
    Report(scenario.name + ": power cut", tally);
  }

  void CutLying(const Scenario& scenario, size_t cuts) {
    Tally tally;
    while (tally.tried < cuts) {
      Saves saves;
      Prepare(scenario, live_.path(), saves);
      scenario.run(live_.path() + kName, seed_ + tally.tried, saves);
      for (size_t k = 0; k < 200 && tally.tried < cuts; ++k) {
        const size_t instant = random_() % (DiskLog::Get().size() + 1);
        CutAt({.instant = instant,
               .unsynced = Unsynced::kAny,
               .lies_from = random_() % (instant + 1)},
              tally.tried, saves, tally);
      }
    }
    // Nobody can keep what such a disk loses; what is there is right, or said to be damaged.
    std::erase_if(tally.wrong, [](const std::string& why) {
      return why.find("a map that nobody saved") == std::string::npos &&
             why.find("what it goes on with") == std::string::npos &&
             why.find("cannot go on") == std::string::npos;
    });
    Report(scenario.name + ": lying disk", tally);
  }

  // Pictures, logs and exports are the old file or the new one, once it is made the new one.
  void CutNewFile() {
    Tally tally;
    const std::string path = live_.path() + "/picture";
    const std::string old_content(5'000, 'o');
    const std::string new_content(20'000, 'n');
    for (const bool is_first : {true, false}) {
      DiskLog::Get().End();
      std::filesystem::remove_all(live_.path() + kName);
      if (is_first) std::filesystem::remove(path);
      if (!is_first) WriteFile(path, old_content).IgnoreError();
      DiskLog::Get().Begin(live_.path());
      WriteFile(path, new_content).IgnoreError();
      for (size_t instant = 0; instant <= DiskLog::Get().size(); ++instant) {
        for (int k = 0; k < 20; ++k) {
          DiskLog::Get().WriteDisk({.instant = instant, .unsynced = static_cast<Unsynced>(k % 3)},
                                   random_, dead_.path());
          const auto found = ReadFile(dead_.path() + "/picture");
          const bool is_old = is_first ? !found.ok() : found.ok() && *found == old_content;
          const bool is_new = found.ok() && *found == new_content;
          ++tally.tried;
          if (is_new || (is_old && instant < DiskLog::Get().size())) {
            ++tally.newest;
          } else {
            tally.wrong.push_back(fmt::format("instant {}", instant));
          }
        }
      }
    }
    Report("picture: power cut", tally);
  }

  // Returns how many operations of the kind there were.
  size_t RunFailing(const Scenario& scenario, Failure failure, size_t first, size_t count,
                    Saves& saves) {
    Prepare(scenario, live_.path(), saves);
    DiskLog::Get().FailFrom(failure, first, count);
    scenario.run(live_.path() + kName, seed_, saves);
    const size_t counted = DiskLog::Get().counted();
    DiskLog::Get().FailNothing();
    return counted;
  }

  // Every operation of a kind fails once, or from then on; then the power is cut as well.
  void Fail(const Scenario& scenario, size_t cuts) {
    constexpr std::array<std::pair<Failure, const char*>, 5> kFailures{
        {{Failure::kSync, "failing sync"},
         {Failure::kWrite, "failing write"},
         {Failure::kShortWrite, "short write"},
         {Failure::kFullDisk, "full disk"},
         {Failure::kRead, "failing read"}}};
    for (const auto& [failure, text] : kFailures) {
      Tally tally;
      Saves undisturbed;
      const size_t operations = RunFailing(scenario, failure, 0, 0, undisturbed);
      for (size_t n = 0; n < operations; n += 1 + 30 * operations / std::max<size_t>(cuts, 1)) {
        for (const size_t count : {size_t{1}, size_t{3}, size_t{1} << 40}) {
          Saves saves;
          RunFailing(scenario, failure, n, count, saves);
          for (const Unsynced unsynced : {Unsynced::kLost, Unsynced::kKept}) {
            CutAt({.instant = DiskLog::Get().size(), .unsynced = unsynced}, n, saves, tally);
          }
        }
      }
      Report(fmt::format("{}: {}", scenario.name, text), tally);
    }
  }

  void CutAt(const DiskLog::Cut& cut, uint64_t round, const Saves& saves, Tally& tally) {
    DiskLog::Get().WriteDisk(cut, random_, dead_.path());
    const bool goes_on = random_() % 4 == 0;
    Check(
        dead_.path() + kName, cut.instant, saves, goes_on,
        fmt::format("round {}, instant {}, {}", round, cut.instant, static_cast<int>(cut.unsynced)),
        tally);
  }

  void Report(const std::string& name, const Tally& tally) {
    Print(name, tally);
    Tally& total = totals_[name.substr(name.find(": ") + 2)];
    total.tried += tally.tried;
    total.newest += tally.newest;
    total.older += tally.older;
    total.max_lost = std::max(total.max_lost, tally.max_lost);
    total.named += tally.named;
    total.unreadable += tally.unreadable;
    total.wrong.insert(total.wrong.end(), tally.wrong.begin(), tally.wrong.end());
    if (!tally.wrong.empty()) is_right_ = false;
  }

  const size_t cuts_;
  const uint64_t seed_;
  const std::string only_;
  std::mt19937_64 random_{seed_};
  const TemporaryDirectory live_;
  const TemporaryDirectory dead_;
  std::map<std::string, Tally> totals_;
  bool is_right_ = true;
};

int Main(int argc, char** argv) {
  CLI::App app("Cuts the power of a disk at every instant of what is done to map files");
  size_t cuts = 3000;
  uint64_t seed = 1;
  std::string only;
  app.add_option("--cuts", cuts, "Power cuts to try, about")->capture_default_str();
  app.add_option("--seed", seed, "Of all that is random")->capture_default_str();
  app.add_option("--only", only, "What is done: a name of the table");
  CLI11_PARSE(app, argc, argv);
  DiskLog::Get();
  return Faults(cuts, seed, only).Run() ? 0 : 1;
}

}  // namespace
}  // namespace splinemap

int main(int argc, char** argv) { return splinemap::Main(argc, argv); }
