#include "tests/fault/disk_log.h"

#include <dlfcn.h>
#include <fcntl.h>
#include <sqlite3.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <filesystem>
#include <fstream>

namespace splinemap {
namespace {

constexpr size_t kSectorBytes = 512;

std::string ContentOfFile(const std::string& path) {
  std::ifstream in(path, std::ios::binary);
  return {std::istreambuf_iterator<char>(in), {}};
}

void Apply(std::string& content, uint64_t place, const std::string& bytes) {
  if (content.size() < place + bytes.size()) content.resize(place + bytes.size());
  content.replace(place, bytes.size(), bytes);
}

// Some sectors of a write, one in eight of them with anything.
void ApplyTorn(std::string& content, uint64_t place, const std::string& bytes,
               std::mt19937_64& random) {
  for (size_t at = 0; at < bytes.size();) {
    const size_t end =
        std::min(bytes.size(), (place + at) / kSectorBytes * kSectorBytes + kSectorBytes - place);
    std::string sector = bytes.substr(at, end - at);
    if (random() % 8 == 0) {
      for (char& byte : sector) byte = static_cast<char>(random());
    }
    if (random() % 2 == 0) Apply(content, place + at, sector);
    at = end;
  }
}

}  // namespace

void DiskLog::Begin(const std::string& folder) {
  *this = DiskLog();
  folder_ = folder;
  for (const auto& entry : std::filesystem::directory_iterator(folder)) {
    const int file = static_cast<int>(initial_.size());
    initial_.push_back(ContentOfFile(entry.path()));
    initial_names_[entry.path().filename()] = file;
  }
  now_ = initial_;
  names_ = initial_names_;
}

void DiskLog::WriteDisk(const Cut& cut, std::mt19937_64& random, const std::string& folder) const {
  // Up to where all of a file, or all names, are on the disk.
  std::map<int, size_t> synced;
  constexpr int kNames = -1;
  for (size_t k = 0; k < std::min(cut.instant, cut.lies_from.value_or(cut.instant)); ++k) {
    if (operations_[k].kind == Kind::kSync) synced[operations_[k].file] = k;
    if (operations_[k].kind == Kind::kSyncNames) synced[kNames] = k;
  }
  std::vector<std::string> contents = initial_;
  std::map<std::string, int> names = initial_names_;
  contents.resize(now_.size());
  for (size_t k = 0; k < cut.instant; ++k) {
    const Operation& operation = operations_[k];
    const auto until = synced.find(operation.file);
    const bool is_synced = until != synced.end() && k < until->second && !operation.never_synced;
    const bool is_kept = is_synced || cut.unsynced == Unsynced::kKept ||
                         (cut.unsynced == Unsynced::kAny && random() % 2 == 0);
    switch (operation.kind) {
      case Kind::kWrite: {
        std::string& content = contents[static_cast<size_t>(operation.file)];
        if (is_kept) {
          Apply(content, operation.place, operation.bytes);
        } else if (cut.unsynced == Unsynced::kAny && random() % 2 == 0) {
          ApplyTorn(content, operation.place, operation.bytes, random);
        }
        break;
      }
      case Kind::kTruncate:
        if (is_kept) contents[static_cast<size_t>(operation.file)].resize(operation.place);
        break;
      case Kind::kName:
        if (is_kept) names[operation.name] = static_cast<int>(operation.place);
        break;
      case Kind::kRename: {
        const auto from = names.find(operation.name);
        if (!is_kept) break;
        // A rename is of names; one whose file was named in vain gives the file its name.
        names[operation.to] = static_cast<int>(operation.place);
        if (from != names.end()) names.erase(from);
        break;
      }
      case Kind::kUnlink:
        if (is_kept) names.erase(operation.name);
        break;
      case Kind::kSync:
      case Kind::kSyncNames:
        break;
    }
  }
  for (const auto& entry : std::filesystem::directory_iterator(folder)) {
    std::filesystem::remove_all(entry);
  }
  for (const auto& [name, file] : names) {
    std::ofstream(folder + "/" + name, std::ios::binary) << contents[static_cast<size_t>(file)];
  }
}

void DiskLog::FailFrom(Failure failure, size_t n, size_t count) {
  failing_ = Failing{failure, n, count};
}

bool DiskLog::Fails(Failure failure) {
  if (!failing_ || failing_->failure != failure) return false;
  const size_t n = failing_->counted++;
  return n >= failing_->first && n - failing_->first < failing_->count;
}

bool DiskLog::Watches(const std::string& path) const {
  return !folder_.empty() && path.starts_with(folder_ + "/");
}

std::string DiskLog::NameOf(const std::string& path) const {
  return path.substr(folder_.size() + 1);
}

void DiskLog::Wrote(int file, uint64_t place, const void* bytes, size_t size) {
  std::string written(static_cast<const char*>(bytes), size);
  Apply(now_[static_cast<size_t>(file)], place, written);
  operations_.push_back(
      {.kind = Kind::kWrite, .file = file, .place = place, .bytes = std::move(written)});
}

void DiskLog::Truncated(int file, uint64_t size) {
  now_[static_cast<size_t>(file)].resize(size);
  operations_.push_back({.kind = Kind::kTruncate, .file = file, .place = size});
}

void DiskLog::Synced(int file) {
  operations_.push_back({.kind = file < 0 ? Kind::kSyncNames : Kind::kSync, .file = file});
}

void DiskLog::FailedToSync(int file) {
  for (size_t k = operations_.size(); k-- > 0;) {
    Operation& operation = operations_[k];
    if (operation.file != file) continue;
    if (operation.kind == Kind::kSync || operation.kind == Kind::kSyncNames) break;
    operation.never_synced = true;
  }
}

void DiskLog::Observe(int file, const std::string& path) {
  const std::string found = ContentOfFile(path);
  const std::string& known = now_[static_cast<size_t>(file)];
  if (found.size() < known.size()) Truncated(file, found.size());
  constexpr size_t kBlock = 4096;
  for (size_t at = 0; at < found.size(); at += kBlock) {
    const std::string block = found.substr(at, kBlock);
    if (at + block.size() <= known.size() && known.compare(at, block.size(), block) == 0) continue;
    Wrote(file, at, block.data(), block.size());
  }
}

void DiskLog::Names(const std::string& path, int file) {
  names_[NameOf(path)] = file;
  operations_.push_back(
      {.kind = Kind::kName, .place = static_cast<uint64_t>(file), .name = NameOf(path)});
}

int DiskLog::Opened(const std::string& path) {
  const auto found = names_.find(NameOf(path));
  if (found != names_.end()) return found->second;
  now_.emplace_back();
  const int file = static_cast<int>(now_.size()) - 1;
  Names(path, file);
  return file;
}

int DiskLog::Seen(const std::string& path) {
  const int file = Opened(path);
  Observe(file, path);
  return file;
}

void DiskLog::Renamed(int file, const std::string& from, const std::string& to) {
  names_.erase(NameOf(from));
  names_[NameOf(to)] = file;
  operations_.push_back({.kind = Kind::kRename,
                         .place = static_cast<uint64_t>(file),
                         .name = NameOf(from),
                         .to = NameOf(to)});
}

void DiskLog::Unlinked(const std::string& path) {
  if (names_.erase(NameOf(path)) == 0) return;
  operations_.push_back({.kind = Kind::kUnlink, .name = NameOf(path)});
}

// A VFS that passes on to the one of Unix what it records.
namespace {

// While SQLite syncs, which the VFS records; the folders that it syncs along with a file are not.
thread_local bool is_in_vfs = false;

struct LoggedFile {
  sqlite3_file base;
  int file;  // -1: not recorded
  sqlite3_file* real() { return reinterpret_cast<sqlite3_file*>(this + 1); }
};

LoggedFile& Logged(sqlite3_file* file) { return *reinterpret_cast<LoggedFile*>(file); }
sqlite3_file* RealOf(sqlite3_file* file) { return Logged(file).real(); }
bool Fails(sqlite3_file* file, DiskLog::Failure failure) {
  return Logged(file).file >= 0 && DiskLog::Get().Fails(failure);
}

int CloseFile(sqlite3_file* file) { return RealOf(file)->pMethods->xClose(RealOf(file)); }

int ReadFrom(sqlite3_file* file, void* bytes, int size, sqlite3_int64 place) {
  if (Fails(file, DiskLog::Failure::kRead)) return SQLITE_IOERR_READ;
  return RealOf(file)->pMethods->xRead(RealOf(file), bytes, size, place);
}

int WriteTo(sqlite3_file* file, const void* bytes, int size, sqlite3_int64 place) {
  if (Fails(file, DiskLog::Failure::kWrite)) return SQLITE_IOERR_WRITE;
  if (Fails(file, DiskLog::Failure::kFullDisk)) return SQLITE_FULL;
  const bool is_short = Fails(file, DiskLog::Failure::kShortWrite);
  if (is_short) size /= 2;
  const int result = RealOf(file)->pMethods->xWrite(RealOf(file), bytes, size, place);
  if (result == SQLITE_OK && Logged(file).file >= 0) {
    DiskLog::Get().Wrote(Logged(file).file, static_cast<uint64_t>(place), bytes,
                         static_cast<size_t>(size));
  }
  return is_short ? SQLITE_FULL : result;
}

int TruncateFile(sqlite3_file* file, sqlite3_int64 size) {
  const int result = RealOf(file)->pMethods->xTruncate(RealOf(file), size);
  if (result == SQLITE_OK && Logged(file).file >= 0) {
    DiskLog::Get().Truncated(Logged(file).file, static_cast<uint64_t>(size));
  }
  return result;
}

int SyncOpenFile(sqlite3_file* file, int flags) {
  if (Fails(file, DiskLog::Failure::kSync)) {
    DiskLog::Get().FailedToSync(Logged(file).file);
    return SQLITE_IOERR_FSYNC;
  }
  is_in_vfs = true;
  const int result = RealOf(file)->pMethods->xSync(RealOf(file), flags);
  is_in_vfs = false;
  if (result == SQLITE_OK && Logged(file).file >= 0) DiskLog::Get().Synced(Logged(file).file);
  return result;
}

const sqlite3_io_methods kMethods{
    .iVersion = 2,
    .xClose = &CloseFile,
    .xRead = &ReadFrom,
    .xWrite = &WriteTo,
    .xTruncate = &TruncateFile,
    .xSync = &SyncOpenFile,
    .xFileSize =
        [](sqlite3_file* file, sqlite3_int64* size) {
          return RealOf(file)->pMethods->xFileSize(RealOf(file), size);
        },
    .xLock = [](sqlite3_file* file,
                int lock) { return RealOf(file)->pMethods->xLock(RealOf(file), lock); },
    .xUnlock = [](sqlite3_file* file,
                  int lock) { return RealOf(file)->pMethods->xUnlock(RealOf(file), lock); },
    .xCheckReservedLock =
        [](sqlite3_file* file, int* result) {
          return RealOf(file)->pMethods->xCheckReservedLock(RealOf(file), result);
        },
    .xFileControl =
        [](sqlite3_file* file, int what, void* argument) {
          return RealOf(file)->pMethods->xFileControl(RealOf(file), what, argument);
        },
    .xSectorSize =
        [](sqlite3_file* file) { return RealOf(file)->pMethods->xSectorSize(RealOf(file)); },
    .xDeviceCharacteristics =
        [](sqlite3_file* file) {
          return RealOf(file)->pMethods->xDeviceCharacteristics(RealOf(file));
        },
    .xShmMap =
        [](sqlite3_file* file, int region, int size, int extend, void volatile** at) {
          return RealOf(file)->pMethods->xShmMap(RealOf(file), region, size, extend, at);
        },
    .xShmLock =
        [](sqlite3_file* file, int offset, int count, int flags) {
          return RealOf(file)->pMethods->xShmLock(RealOf(file), offset, count, flags);
        },
    .xShmBarrier = [](sqlite3_file* file) { RealOf(file)->pMethods->xShmBarrier(RealOf(file)); },
    .xShmUnmap = [](sqlite3_file* file,
                    int remove) { return RealOf(file)->pMethods->xShmUnmap(RealOf(file), remove); },
    .xFetch = nullptr,
    .xUnfetch = nullptr,
};

int OpenFile(sqlite3_vfs* vfs, const char* name, sqlite3_file* file, int flags, int* flags_out) {
  auto* const real = static_cast<sqlite3_vfs*>(vfs->pAppData);
  Logged(file).base.pMethods = nullptr;
  Logged(file).file = -1;
  const int result = real->xOpen(real, name, RealOf(file), flags, flags_out);
  if (result != SQLITE_OK) return result;
  Logged(file).base.pMethods = &kMethods;
  if (name != nullptr && DiskLog::Get().Watches(name)) {
    Logged(file).file = DiskLog::Get().Opened(name);
  }
  return SQLITE_OK;
}

template <typename Function>
Function* NextOf(const char* name) {
  return reinterpret_cast<Function*>(dlsym(RTLD_NEXT, name));
}

// Nothing is brought to the true disk: nobody cuts its power, and it takes most of the time.
int SyncDescriptor(int descriptor) {
  std::error_code error;
  const std::string path =
      std::filesystem::read_symlink("/proc/self/fd/" + std::to_string(descriptor), error);
  struct stat status {};
  if (error || fstat(descriptor, &status) != 0) return -1;
  DiskLog& log = DiskLog::Get();
  const bool is_folder = S_ISDIR(status.st_mode);
  if (is_folder ? !log.Watches(path + "/") : is_in_vfs || !log.Watches(path)) return 0;
  const int file = is_folder ? -1 : log.Seen(path);
  if (!is_in_vfs && log.Fails(DiskLog::Failure::kSync)) {
    log.FailedToSync(file);
    errno = EIO;
    return -1;
  }
  log.Synced(file);
  return 0;
}

}  // namespace

DiskLog& DiskLog::Get() {
  static DiskLog& log = []() -> DiskLog& {
    sqlite3_initialize();
    sqlite3_vfs* const real = sqlite3_vfs_find(nullptr);
    static sqlite3_vfs vfs = *real;
    vfs.zName = "disk_log";
    vfs.pAppData = real;
    vfs.szOsFile = static_cast<int>(sizeof(LoggedFile)) + real->szOsFile;
    vfs.xOpen = &OpenFile;
    sqlite3_vfs_register(&vfs, 1);
    static DiskLog only;
    return only;
  }();
  return log;
}

}  // namespace splinemap

extern "C" {

int fsync(int descriptor) { return splinemap::SyncDescriptor(descriptor); }
int fdatasync(int descriptor) { return splinemap::SyncDescriptor(descriptor); }

int rename(const char* from, const char* to) noexcept {
  auto& log = splinemap::DiskLog::Get();
  const bool is_watched = log.Watches(from) && log.Watches(to);
  const int file = is_watched ? log.Seen(from) : -1;
  const int result = splinemap::NextOf<int(const char*, const char*)>("rename")(from, to);
  if (result == 0 && is_watched) log.Renamed(file, from, to);
  return result;
}

int link(const char* from, const char* to) noexcept {
  auto& log = splinemap::DiskLog::Get();
  const int result = splinemap::NextOf<int(const char*, const char*)>("link")(from, to);
  if (result == 0 && log.Watches(to)) log.Names(to, log.Seen(from));
  return result;
}

int unlink(const char* path) noexcept {
  const int result = splinemap::NextOf<int(const char*)>("unlink")(path);
  if (result == 0 && splinemap::DiskLog::Get().Watches(path)) {
    splinemap::DiskLog::Get().Unlinked(path);
  }
  return result;
}

int remove(const char* path) noexcept {
  const int result = splinemap::NextOf<int(const char*)>("remove")(path);
  if (result == 0 && splinemap::DiskLog::Get().Watches(path)) {
    splinemap::DiskLog::Get().Unlinked(path);
  }
  return result;
}

}  // extern "C"
