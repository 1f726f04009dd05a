#pragma once

#include <cstddef>
#include <cstdint>
#include <map>
#include <optional>
#include <random>
#include <string>
#include <vector>

namespace splinemap {

// Everything that this process asks of the disk about the files of one folder, in its order: writes
// and syncs of SQLite, by a VFS that is SQLite's default from Get() on, and what std::filesystem
// and we do to names, by functions of the C library that the program defines (rename, link, unlink,
// remove, fsync, fdatasync). The disk that a power cut leaves is made of it afterwards, for any
// instant and as often as one likes. Thread-compatible; there is one for the process.
class DiskLog {
 public:
  static DiskLog& Get();

  // Begins anew: what is in `folder` is on the disk.
  void Begin(const std::string& folder);
  void End() { folder_.clear(); }
  // How much was asked so far; an instant is a number up to it.
  size_t size() const { return operations_.size(); }

  // What the disk does with what was not synced.
  enum class Unsynced { kLost, kKept, kAny };
  struct Cut {
    size_t instant = 0;
    Unsynced unsynced = Unsynced::kAny;
    // From this instant on the disk has said that it synced, and did not.
    std::optional<size_t> lies_from{};
  };
  // Writes the disk after a cut into `folder`, which is emptied. Unsynced::kAny: each write that
  // was not synced is there, is not, or is there in some of its sectors, of which one in eight
  // holds anything; each name that was not synced is changed or is not.
  void WriteDisk(const Cut& cut, std::mt19937_64& random, const std::string& folder) const;

  // The operations of a kind fail from the n-th on, counted from 0, so many of them.
  enum class Failure { kSync, kWrite, kShortWrite, kFullDisk, kRead };
  void FailFrom(Failure failure, size_t n, size_t count = 1);
  void FailNothing() { failing_.reset(); }
  // Operations of the kind of FailFrom(), since then.
  size_t counted() const { return failing_ ? failing_->counted : 0; }

  // Of the VFS and the C library's functions. Files count from 0; -1 are the names of the folder.
  bool Watches(const std::string& path) const;
  int Opened(const std::string& path);
  // The same for a file that others than SQLite wrote: what they wrote is found out.
  int Seen(const std::string& path);
  void Wrote(int file, uint64_t place, const void* bytes, size_t size);
  void Truncated(int file, uint64_t size);
  void Synced(int file);
  // What was written stays readable, and no later sync brings it to the disk.
  void FailedToSync(int file);
  void Names(const std::string& path, int file);
  void Renamed(int file, const std::string& from, const std::string& to);
  void Unlinked(const std::string& path);
  bool Fails(Failure failure);

 private:
  enum class Kind { kWrite, kTruncate, kSync, kName, kRename, kUnlink, kSyncNames };
  struct Operation {
    Kind kind;
    int file = -1;
    uint64_t place = 0;  // of a truncation, the size
    std::string bytes{};
    std::string name{};
    std::string to{};
    bool never_synced = false;
  };
  struct Failing {
    Failure failure;
    size_t first;
    size_t count;
    size_t counted = 0;
  };

  void Observe(int file, const std::string& path);
  std::string NameOf(const std::string& path) const;

  std::string folder_;
  std::vector<Operation> operations_;
  std::map<std::string, int> initial_names_;
  std::map<std::string, int> names_;
  std::vector<std::string> initial_;  // by file
  std::vector<std::string> now_;
  std::optional<Failing> failing_;
};

}  // namespace splinemap
